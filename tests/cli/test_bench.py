# SPDX-License-Identifier: Apache-2.0
"""Command ``stripe-newton bench``: its file, its table, its errors."""

from __future__ import annotations

import json

import pytest

from stripe_newton.cli import main
from stripe_newton.cli.bench import table

TASK = "Stripe-Cartpole-Direct-v0"
KEYS = {
    *("task", "device", "num_envs", "decimation", "physics_ms", "env_ms", "overhead_ratio", "env_steps_per_s"),
    *("graph_launches_per_step", "kernel_launches_per_step", "host_syncs_per_step", "build_s", "first_step_s"),
    *("import_s", "ready_s"),
}


def test_bench_writes_what_the_design_names(capsys):
    argv = ["bench", TASK, "--num-envs", "4", "--steps", "4", "--device", "cpu", "--json", "out/cartpole.json"]
    assert main(argv) == 0
    with open("out/cartpole.json") as file:
        result = json.load(file)
    assert result.keys() >= KEYS
    assert (result["task"], result["device"], result["num_envs"], result["decimation"]) == (TASK, "cpu", 4, 2)
    assert result["overhead_ratio"] == pytest.approx(result["env_ms"] / result["physics_ms"] - 1.0)
    assert result["env_steps_per_s"] == pytest.approx(4e3 / result["env_wall_ms"])
    assert [result[f"{kind}_per_step"] for kind in ("graph_launches", "kernel_launches", "host_syncs")] == [None] * 3
    assert result["replay_difference"] == 0.0
    out = capsys.readouterr().out
    assert f"{TASK}, 4 environments on cpu" in out
    assert f"{result['physics_ms']:.3f} ms" in out
    assert f"{result['env_ms']:.3f} ms" in out


def test_the_table_of_a_gpu_has_the_calls():
    result = {
        "task": "T-v0",
        "num_envs": 4096,
        "device": "cuda:0",
        "device_name": "NVIDIA X",
        "physics_ms": 2.0,
        "physics_range_ms": [1.9, 2.2],
        "env_ms": 2.1,
        "env_range_ms": [2.0, 2.3],
        "overhead_ratio": 0.05,
        "env_steps_per_s": 2e6,
        "graph_launches_per_step": 1.0,
        "kernel_launches_per_step": 0.0,
        "host_syncs_per_step": 0.015625,
        "build_s": 1.0,
        "first_step_s": 2.0,
        "import_s": 1.5,
        "ready_s": 4.5,
    }
    text = table(result)
    assert "4.50 s from the command" in text
    assert "T-v0, 4096 environments on NVIDIA X" in text
    assert "5.0 % of the physics" in text
    assert "1 graph launches, 0 kernel launches, 0.01562 host syncs" in text


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["bench"], "bench needs a task"),
        (["bench", TASK, "--steps", "0"], "--steps 0: must be at least 1"),
        (["bench", TASK, "--device", "cuda:99"], "there is no such device"),
        (["bench", TASK, "--num-envs", "-3", "--device", "cpu"], "env.scene.num_envs"),
    ],
)
def test_errors_are_one_message(capsys, argv, message):
    assert main(argv) == 2
    assert message in capsys.readouterr().err
