# SPDX-License-Identifier: Apache-2.0
"""Sweeps of a fake training: their configs, runs and calls."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from stripe_newton.rl.experiments.sweep import Sweep
from stripe_newton.rl.experiments.sweep_cfg import Space, SweepCfg
from stripe_newton.rl.experiments.sweep_process import Slot
from tests.helpers.checkout import HELPERS
from tests.helpers.fake_env import TASK

FAKE = [sys.executable, str(HELPERS / "fake_training.py")]
CPU = Slot("the CPU", "cpu", {"CUDA_VISIBLE_DEVICES": ""})
GAMMA, LAM, DELAY = "agent.algorithm.gamma", "agent.algorithm.lam", "agent.algorithm.max-grad-norm"


def sweep(cfg: SweepCfg, slots: list[Slot] | None = None, folder: str = "sweep") -> tuple[Sweep, list[str]]:
    lines: list[str] = []
    return Sweep(cfg, Path(folder), slots or [CPU], FAKE, show=lines.append, poll_s=0.02), lines


def run(cfg: SweepCfg, slots: list[Slot] | None = None) -> tuple[Sweep, list[str]]:
    made, lines = sweep(cfg, slots)
    assert made.run()
    made.close()
    return made, lines


def cfg_of(**changes) -> SweepCfg:
    spaces = {GAMMA: Space(choices=(0.9, 0.5))}
    return SweepCfg(**{"task": TASK, "spaces": spaces, "seeds": (1, 2), "trials": 2, "max_iterations": 4} | changes)


def calls(folder: str = "sweep") -> list[dict]:
    """Every start of the fake training, in order."""
    lines = [line for file in Path(folder).rglob("calls.jsonl") for line in file.read_text().splitlines()]
    return sorted(map(json.loads, lines), key=lambda call: call["t"])
