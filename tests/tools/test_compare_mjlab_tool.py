# SPDX-License-Identifier: Apache-2.0
"""Tool ``compare_mjlab.py`` without mjlab: measurement of a side, the table, errors."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from tests.helpers.checkout import TOOLS

sys.path.insert(0, str(TOOLS / "comparison"))

import compare_mjlab as tool
import compare_mjlab_measure as measuring


class Toy:
    """An environment of one number, and a runner that learns nothing."""

    def __init__(self) -> None:
        self.state, self.target = torch.zeros(2, 1), torch.zeros(2, 1)
        self.started_from: list[float] = []
        self.lengths = torch.zeros(2)
        self.logger = SimpleNamespace(log=lambda **values: None, rewbuffer=[], lenbuffer=[])
        self.cfg = {"num_steps_per_env": 5}
        self.actor = torch.nn.Linear(1, 1)
        self.alg, self.env, self.done = SimpleNamespace(actor=self.actor), self, torch.zeros(2)

    def reset(self) -> torch.Tensor:
        self.steps = 0
        return torch.ones(2, 1)

    def step(self, action: torch.Tensor) -> Any:
        self.target.copy_(action)
        self.physics()
        self.steps = getattr(self, "steps", 0) + 1
        self.done[1] = self.steps == self.falls_after
        return torch.ones(2, 1), None, self.done.clone(), {}

    falls_after = -1

    def physics(self) -> None:
        self.started_from.append(float(self.state[0]))
        self.state += 1.0

    def learn(self, iterations: int, init_at_random_ep_len: bool) -> None:
        for index in range(iterations):
            if index:
                self.logger.rewbuffer.append(float(index))
                self.logger.lenbuffer.append(10.0)
            with torch.no_grad():
                self.actor.weight.zero_()
                self.actor.bias.fill_(1.0 / (1 + index))  # what it does, and how far off the velocity is
            self.logger.log(it=index, collect_time=0.25, learn_time=0.5)

    def side(self) -> Any:
        spread = self.lengths.copy_
        return measuring.Side(
            "cpu",
            2,
            1,
            self.step,
            self.physics,
            [self.state],
            [self.target],
            spread,
            100,
            lambda folder: self,
            lambda: self.target[:, 0],
        )


def test_a_side_is_measured():
    toy = Toy()
    request = {"device": "cpu", "parts": ["step", "train"], "steps": 6, "train_iterations": 3, "seed": 0, "asked": 0.0}
    found = measuring.measure(toy.side, request)
    assert found["blocks"] == 1
    assert found["steps_in_block"] == 6
    assert min(found["physics_ms"], found["step_ms"], found["build_s"]) > 0.0
    assert found["graph_launches_per_step"] is None
    assert found["memory_mb"] is None
    assert toy.lengths.any()
    first = 1 + 2 * 6  # steps before the tape
    assert toy.started_from[-6:] == [float(first + k) for k in range(6)]  # the physics begins where the steps did
    curve = found["curve"]
    assert [row["samples"] for row in curve] == [10, 20, 30]
    assert [row["return"] for row in curve] == [None, 1.0, 1.5]
    assert (found["collect_s"], found["learn_s"]) == (0.25, 0.5)
    assert found["samples_per_s"] == pytest.approx(10 / found["iteration_s"])
    assert found["start_s"] > 1.0e9  # from the command, here in 1970


def test_when_a_robot_walked(monkeypatch):
    request = {"device": "cpu", "parts": ["train", "walk"], "train_iterations": 8, "asked": time.time()}
    monkeypatch.setattr(measuring, "TRY_EVERY", 4)
    found = measuring.measure(Toy().side, request)
    errors = [0.25, 0.125]  # after four and after eight iterations
    assert [row["velocity_error"] for row in found["tried"]] == pytest.approx(errors)
    assert [row["walks"] for row in found["tried"]] == [False, True]  # it must be under 0.25 m/s
    assert found["walk_samples"] == 80
    assert found["start_s"] < found["walk_s"] < 60.0
    falling = Toy()
    falling.falls_after = 50
    found = measuring.measure(falling.side, request)
    assert [row["upright"] for row in found["tried"]] == [1.0, 0.0]
    assert found["tried"][1]["velocity_error"] == pytest.approx(0.125)  # as long as it was up
    assert found["walk_s"] is None
    assert found["walk_samples"] is None


def rows(*points: tuple[int, float, float | None]) -> list[dict[str, Any]]:
    return [{"samples": samples, "seconds": seconds, "return": value} for samples, seconds, value in points]


def test_returns_after_the_same_samples_and_the_same_time():
    fast = rows((10, 1.0, None), (20, 2.0, 5.0), (30, 3.0, 7.0))
    slow = rows((10, 2.5, 1.0), (20, 5.0, 6.0), (30, 7.5, 8.0))
    assert tool.returns(fast, slow) == {
        "samples": 30,
        "after_samples": [7.0, 8.0],
        "seconds": 3.0,
        "after_seconds": [7.0, 1.0],
    }
    assert tool.returns(fast[:1], slow)["after_samples"] == [None, 1.0]


def test_the_table_has_a_column_a_side(tmp_path):
    common = {"device_name": None, "versions": {"stripe-newton": "1", "mjlab": "2", "torch": "3"}}
    measured = {"step_ms": 2.0, "physics_ms": 1.0, "env_steps_per_s": 500.0, "copies_per_step": None}
    found = {
        "request": {"device": "cpu", "num_envs": 8},
        "others": [],
        "decimation": 4,
        "dt": 0.005,
        "stripe-newton": common | measured | {"curve": rows((10, 1.0, None), (20, 2.0, 5.0))},
        "mjlab": common | measured | {"step_ms": 5.0, "env_steps_per_s": 200.0, "curve": rows((20, 3.0, 4.0))},
    }
    found["returns"] = tool.returns(found["stripe-newton"]["curve"], found["mjlab"]["curve"])
    lines = {re.split(r"  +", line)[0]: re.split(r"  +", line.strip())[1:] for line in tool.table(found).splitlines()}
    assert lines["whole step [ms]"] == ["2.000", "5.000", "2.50"]
    assert lines["environment steps a second"] == ["500", "200", "2.50"]
    assert lines["copies and fills a step, outside graphs"] == ["-", "-"]
    assert lines["return after 20 samples"] == ["5.00", "4.00"]
    assert lines["return after 2.0 s"] == ["5.00", "-"]
    assert "cpu, 8 environments, 4 physics steps of 5 ms a step" in lines
    found["others"] = [tool.UNFUSED, "T-v0"]
    found[tool.UNFUSED] = measured | {"physics_ms": 2.0, "curve": [], "physics_by": "MuJoCo Warp"}
    found["T-v0"] = measured | {"physics_ms": 0.5}
    lines = {re.split(r"  +", line)[0]: re.split(r"  +", line.strip())[1:] for line in tool.table(found).splitlines()}
    assert lines["physics alone [ms]"] == ["1.000", "1.000", "1.00", "2.000", "0.50", "0.500", "2.00"]
    assert "with MuJoCo Warp: MuJoCo Warp" in lines
    tool.plot(found, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--mjlab-python or --mjlab-path"),
        (["--mjlab-path", "x", "--num-envs", "0"], "--num-envs: is 0, must be 1 or more"),
        (["--mjlab-path", "x", "--parts", "step", "--plot", "a.png"], "--plot: shows the training"),
        (["--mjlab-path", "x", "--parts", "step", "walk"], "walk is about the training, so add train"),
        (["--mjlab-path", "x", "--task", "Stripe-Nothing-v0"], "--task Stripe-Nothing-v0: "),
        (["--mjlab-path", "x", "--task", "Stripe-Cartpole-v0"], "does not follow velocity commands"),
        (["--mjlab-path", "x", "--task", "Stripe-Cartpole-Direct-v0"], "is not made of managers"),
    ],
)
def test_what_cannot_be_compared_is_said(arguments, message, capsys):
    with pytest.raises(SystemExit):
        tool.parse(arguments)
    assert message in capsys.readouterr().err


def test_a_velocity_task_can_be_measured_too():
    task = "Stripe-Velocity-Flat-Quadruped-v0"
    assert tool.parse(["--mjlab-path", "x", "--task", task]).task == task


def test_a_run_ends_before_mjlab_widens_its_commands(tmp_path):
    curriculum = {"command_vel": {"params": {"velocity_stages": [{"step": 0}, {"step": 240}]}}}
    facts = {"env": {"curriculum": curriculum}, "agent": {"num_steps_per_env": 24}}
    tool._check(facts, tool.parse(["--mjlab-path", "x", "--train-iterations", "10"]))
    tool._check(facts, tool.parse(["--mjlab-path", "x", "--train-iterations", "11", "--parts", "step"]))
    with pytest.raises(SystemExit, match="is 11, must be at most 10"):
        tool._check(facts, tool.parse(["--mjlab-path", "x", "--train-iterations", "11"]))


def test_a_peer_that_fails_is_an_error(tmp_path):
    with pytest.raises(SystemExit, match="cannot run /nowhere/python"):
        tool.Peer("/nowhere/python", None).ask("describe", {}, tmp_path / "a.json")
    with pytest.raises(SystemExit, match="has no folder 'mjlab'"):
        tool.Peer(None, str(tmp_path))
    request = {"num_envs": 2, "seed": 0, "device": "cpu", "randomize": True}
    (tmp_path / "mjlab").mkdir()
    (tmp_path / "mjlab" / "__init__.py").write_text("raise ImportError('a folder without tasks')")
    with pytest.raises(SystemExit, match=r"(?s)status 1:.*a folder without tasks"):
        tool.Peer(None, str(tmp_path)).ask("describe", request, tmp_path / "a.json")


def test_calls_are_counted_without_this_package():
    """The other side runs in an interpreter that has other versions of what this package imports."""
    code = f"""
import sys
from pathlib import Path
sys.modules["stripe_newton"] = sys.modules["stripe_kernels"] = None  # an import of either is an error
sys.path.insert(0, {str(TOOLS / "comparison")!r})
import warp as wp
from compare_mjlab_measure import by_path
counter = by_path("call_counts", Path({str(TOOLS.parent / "stripe_newton" / "envs" / "call_counts.py")!r}))
wp.init()
with counter.warp_calls() as calls:
    pass
print(dict(calls))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith("{}")
