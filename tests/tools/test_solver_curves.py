# SPDX-License-Identifier: Apache-2.0
"""Tool ``solver_curves.py``: its jobs, its test and its tables, without trainings."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest
from PIL import Image

from tools.benchmarks import solver_curves as tool

TASK = "Stripe-Cartpole-v0"


def write_run(run: tool.Run, returns: list[float], date: str = "date") -> None:
    """Files of a training with some returns; the first iteration has none yet."""
    folder = run.folder / "task" / date
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "checkpoints" / "model_1.pt").write_text("")
    rows = [f"{10 * (n + 1)},{n}.5,{value}" for n, value in enumerate(["", *returns])]
    (folder / "metrics.csv").write_text("\n".join(["total_steps,elapsed_s,Train/mean_reward", *rows]) + "\n")


def runs_in(out: Path, seeds: int) -> list[tool.Run]:
    pairs = [(solver, seed) for seed in range(1, seeds + 1) for solver in tool.SOLVERS]
    return [tool.Run(solver, seed, out / "runs" / f"{solver}_{seed}") for solver, seed in pairs]


def test_jobs_go_on_after_failures_and_end_in_time(tmp_path, capsys):
    def command(code: str) -> list[str]:
        return [sys.executable, "-c", code]

    commands = {
        "good": command("print('fine')"),
        "bad": command("raise SystemExit('too few')"),
        "slow": command("import time; time.sleep(60)"),
    }
    found = tool.run_jobs(commands, tmp_path, jobs=2, seconds=5.0)
    assert found["good"] == ""
    assert found["bad"].startswith("failed with status 1: too few")
    assert found["slow"] == "took longer than 5 s"
    assert (tmp_path / "good.log").read_text() == "fine\n"
    assert "3 of 3: slow" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], 2 / 20),
        ([4.0, 5.0, 6.0], [1.0, 2.0, 3.0], 2 / 20),
        ([1.0, 4.0], [2.0, 3.0], 1.0),
        ([1.0, 2.0], [3.0], 2 / 3),
    ],
)
def test_permutation_test(a, b, expected):
    assert tool.p_value(a, b) == pytest.approx(expected)


def test_no_values_have_no_p_value():
    assert math.isnan(tool.p_value([1.0], []))


def test_a_run_that_was_cut_off_is_trained_again(tmp_path, monkeypatch, capsys):
    started: dict[str, list[str]] = {}
    monkeypatch.setattr(tool, "run_jobs", lambda commands, *args: started.update(commands))
    one, two = runs_in(tmp_path, 1)
    write_run(one, [1.0] * 19)
    write_run(two, [1.0] * 5)
    write_run(two, [1.0] * 3, date="later")
    words = [str(tmp_path), "--task", TASK, "--seeds", "1", "--iterations", "20", "--no-evaluate", "--agent.seed", "7"]
    tool.main(words)
    assert list(started) == ["mujoco_warp_1"]
    command = started["mujoco_warp_1"]
    assert command[command.index("--env.sim.solver.fused") + 1] == "False"
    assert command[command.index("--max-iterations") + 1] == "20"
    assert command[-2:] == ["--agent.seed", "7"]
    assert "fused_1: is there already" in capsys.readouterr().out
    assert [e["iterations"] for e in json.loads((tmp_path / "results.json").read_text())["runs"]] == [20, 6]


def test_table_and_picture(tmp_path):
    runs = runs_in(tmp_path, 3)
    for run in runs[:5]:
        write_run(run, [float(n + 2 * run.seed) for n in range(19)])
    results = {"mean_return": 3.0, "terminated_rate": 0.25, "episodes": 8}
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "evaluation" / "fused.json").write_text(json.dumps({"fused_1": results, "mujoco_warp_1": results}))
    text = tool.show(TASK, runs, tmp_path)
    assert "| one kernel | 3 | 200 | 21.50 ± 2.00 | 13.00 ± 2.00 |" in text
    assert "| MuJoCo Warp | 2 | 200 | 20.50 ± 1.41 | 12.00 ± 1.41 |" in text
    assert "| one kernel | 3.00 ± nan, 25.0 % | - |" in text
    assert text.endswith("Without a result: mujoco_warp_3\n")
    with Image.open(tmp_path / "curves.png") as picture:
        assert picture.size == (780, 494)


@pytest.mark.parametrize(
    ("words", "message"), [([], "OUT: name the folder"), (["out", "--seeds", "0"], "--seeds: is 0, must be 1 or more")]
)
def test_mistakes_are_said(words, message, capsys):
    with pytest.raises(SystemExit):
        tool.parse(words)
    assert message in capsys.readouterr().err
