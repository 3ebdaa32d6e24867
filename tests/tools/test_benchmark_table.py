# SPDX-License-Identifier: Apache-2.0
"""Tool ``benchmark_table.py``: it goes on after failures, keeps to its time, and draws."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from PIL import Image

from tools.benchmarks import benchmark_table

ENTRY = {
    "task": "T-v0",
    "num_envs": 4096,
    "device": "cuda:0",
    "device_name": "NVIDIA X",
    "physics_ms": 2.0,
    "env_ms": 2.1,
    "env_range_ms": [2.0, 2.3],
    "env_wall_ms": 2.2,
    "overhead_ratio": 0.05,
    "env_steps_per_s": 2e6,
    "graph_launches_per_step": 1.0,
    "kernel_launches_per_step": 0.0,
    "host_syncs_per_step": 0.015625,
}


def test_the_tool_goes_on_after_a_failure_and_keeps_what_was_measured(monkeypatch, capsys, tmp_path):
    def measured(task, num_envs, args):
        if task == "Bad-v0":
            raise MemoryError("too large")
        return {**ENTRY, "task": task, "num_envs": num_envs}

    monkeypatch.setattr(benchmark_table, "measure", measured)
    benchmark_table.main(["out", "--parts", "tasks", "--tasks", "Bad-v0", "Good-v0"])
    benchmark_table.main(["out", "--parts", "tasks", "--tasks", "Other-v0", "--num-envs", "16"])
    entries = json.loads((tmp_path / "out" / "tasks.json").read_text())
    assert [(e["task"], e["num_envs"]) for e in entries] == [("Bad-v0", 4096), ("Good-v0", 4096), ("Other-v0", 16)]
    assert entries[0]["error"] == "MemoryError: too large"
    text = (tmp_path / "out" / "benchmarks.md").read_text()
    assert "Measured on NVIDIA X." in text
    assert "| `Good-v0` | 4,096 | 2.000 | 2.100 | 2.000 to 2.300 | 5.0 % | 2.200 | 2,000,000 | 1 | 0 | 0.0156 |" in text
    assert "| `Bad-v0` | 4,096 | MemoryError: too large |" in text
    assert capsys.readouterr().out.endswith(text + "\n")


def test_the_tool_begins_nothing_after_its_time(monkeypatch, tmp_path):
    called = []
    monkeypatch.setattr(benchmark_table, "measure", lambda *args: called.append(args))
    benchmark_table.main(["out", "--parts", "tasks", "scaling", "--budget", "1e-9"])
    assert not called


@pytest.mark.slow
def test_the_tool_draws_the_cost_over_the_number_of_environments(monkeypatch, tmp_path):
    monkeypatch.setattr(benchmark_table, "measure", lambda task, n, args: {**ENTRY, "task": task, "num_envs": n})
    benchmark_table.main(["out", "--parts", "scaling", "--sizes", "1", "4", "16"])
    assert len(json.loads((tmp_path / "out" / "scaling.json").read_text())) == 3 * len(benchmark_table.SCALING_TASKS)
    with Image.open(tmp_path / "out" / "scaling.png") as picture:
        assert picture.size == (1080, 432)


def test_a_start_counts_the_kernels_that_it_compiled(monkeypatch, tmp_path):
    def process(command, env, **kwargs):
        cache = Path(env["WARP_CACHE_PATH"]) / "1.19.0"
        if not cache.exists():
            (cache / "wp_a").mkdir(parents=True)
            (cache / "wp_a" / "a.cubin").write_text("a")
            (cache / "wp_a" / "a.cu").write_text("source")
            (cache / "b.cubin").write_text("b")
        else:
            os.utime(cache / "b.cubin", (1, 1))  # compiled anew
        times = {f"{part}_s": 1.0 for part in ("ready", "import", "build", "reset", "first_step")}
        Path(command[command.index("--json") + 1]).write_text(json.dumps({"device": "cpu", **times}))

    monkeypatch.setattr(benchmark_table.subprocess, "run", process)
    benchmark_table.main(["out", "--parts", "start"])
    (entry,) = json.loads((tmp_path / "out" / "start.json").read_text())
    assert entry["cold"]["kernel_files_made"] == entry["cold"]["kernel_files"] == 2
    assert entry["warm"]["kernel_files_made"] == 1
    assert "| `Stripe-Ant-v0` | 4,096 | cold |" in (tmp_path / "out" / "benchmarks.md").read_text()
