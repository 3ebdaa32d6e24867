# SPDX-License-Identifier: Apache-2.0
"""Tool ``train_robots.py``: rows of trainings that succeed and fail, motions of tracking tasks, tasks that exist."""

from __future__ import annotations

import json
import sys

import pytest

from stripe_newton.cli.tasks import task_ids
from tests.helpers.checkout import TOOLS

sys.path.insert(0, str(TOOLS / "benchmarks"))

import train_robots as tool


def test_the_tasks_of_the_list_exist():
    assert {tool.Job.of(word, 1).task for word in tool.TASKS} <= set(task_ids())
    with pytest.raises(SystemExit, match="must be TASK"):
        tool.Job.of("no task", 1)


def test_rows_have_results_or_reasons_and_the_next_task_follows(tmp_path, monkeypatch, capsys):
    """With commands that write what the real ones write."""
    called = []

    def run(log, *words):
        called.append(words)
        if "Missing" in words[1]:
            raise tool.CommandError("error: robot 'go9' | no file found")
        if words[0] == "train":
            folder = tmp_path / "run"
            folder.mkdir(exist_ok=True)
            rows = ["Iteration,elapsed_s,Train/mean_reward,Perf/total_fps", "0,1,-2,100", "1,5,7,300", "2,9,8,200"]
            (folder / "metrics.csv").write_text("\n".join(rows) + "\n")
            return f"run folder: {folder}\n"
        found = {"terminated_rate": 0.25, "mean_length": 90.0, "max_length": 100, "metrics": {"error": 0.125}}
        (tmp_path / "out" / f"{words[1]}-1.json").write_text(json.dumps(found | {"success_rate": 0.5}))
        return ""

    monkeypatch.setattr(tool, "run", run)
    words = ["train_robots.py", str(tmp_path / "out"), "Missing-v0", "A-Tracking-v0:3@64", "--motions", "m.csv"]
    monkeypatch.setattr(sys, "argv", words)
    tool.main()
    lines = (tmp_path / "out" / "results.md").read_text().splitlines()
    assert len(lines) == 4
    assert lines[2].endswith("| error: robot 'go9' / no file found |")
    cells = [cell.strip() for cell in lines[3].split("|")]
    assert cells[3:7] == ["64", "3", "1", "200"]
    assert cells[8] == "5 s"
    tracked = "success 50.0 %, tracked to the end 75.0 %, ended early 25.0 %, length 90 of 100, error 0.125"
    assert cells[9] == tracked
    train, evaluate = (next(w for w in called if w[:2] == (name, "A-Tracking-v0")) for name in ("train", "eval"))
    assert train[-2:] == ("--env.commands.motion.motion-file", "m.csv")
    assert "start" in evaluate
    assert evaluate[evaluate.index("--episodes") + 1] == "1024"
