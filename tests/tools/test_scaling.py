# SPDX-License-Identifier: Apache-2.0
"""Tool ``scaling.py``: its measurement and its table, without trainings."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tools.benchmarks import scaling as tool


def columns(iterations: int, size: float, seconds: float) -> dict[str, list[float]]:
    """Slow in the warm-up, then as given, a third of it learning."""
    took = [10.0 if n < tool.WARMUP else seconds for n in range(iterations)]
    return {
        "total_steps": [size * (n + 1) for n in range(iterations)],
        "Perf/collection_time": [t * 2.0 / 3.0 for t in took],
        "Perf/learning_time": [t / 3.0 for t in took],
    }


def test_speed_without_the_warm_up():
    assert tool.measure(columns(12, 600.0, 0.3)) == pytest.approx((2000.0, 0.3, 0.2, 0.1))
    with pytest.raises(SystemExit, match="give more --iterations"):
        tool.measure(columns(tool.WARMUP, 600.0, 0.3))


@pytest.mark.parametrize("kind", ["--weak", "--strong"])
def test_trainings_and_table(kind, tmp_path, monkeypatch, capsys):
    """Of four GPUs, weak scaling keeps 80 % and strong scaling 50 %."""
    commands = []
    speed = {"--weak": {1: (100, 1.0), 4: (400, 1.25)}, "--strong": {1: (100, 1.0), 4: (100, 0.5)}}[kind]

    def run(command: list[str], check: bool) -> None:
        commands.append(command)
        gpus = int(command[command.index("--gpus") + 1])
        folder = Path(command[command.index("--log-dir") + 1]) / "task" / "date"
        folder.mkdir(parents=True)
        (folder / "metrics.csv").write_text(str(gpus))

    monkeypatch.setattr(tool, "subprocess", SimpleNamespace(run=run))
    monkeypatch.setattr(tool, "read_metrics", lambda path: columns(9, *speed[int(path.read_text())]))
    words = [str(tmp_path), "--gpus", "1", "4", kind, "--num-envs", "8", "--agent.num-steps-per-env", "16"]
    monkeypatch.setattr(sys, "argv", ["scaling.py", *words])
    tool.main()
    totals = [command[command.index("--num-envs") + 1] for command in commands]
    assert totals == (["8", "32"] if kind == "--weak" else ["8", "8"])
    assert all(command[-2:] == ["--agent.num-steps-per-env", "16"] for command in commands)
    one, four = json.loads((tmp_path / "results.json").read_text())
    assert one["efficiency"] == 1.0
    assert four["efficiency"] == pytest.approx(0.8 if kind == "--weak" else 0.5)
    assert f"| 4 | {totals[1]} | {four['steps_per_s']:,.0f} |" in capsys.readouterr().out
