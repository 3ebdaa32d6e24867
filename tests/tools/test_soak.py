# SPDX-License-Identifier: Apache-2.0
"""Tool ``soak.py``: steps of an environment over a time, and what is told of memory, drift and numbers."""

from __future__ import annotations

import csv
import sys

import numpy as np
import pytest

from tools.benchmarks import soak as tool


def rows(**columns) -> list[dict[str, float]]:
    """Rows of a soak without a problem, with other columns."""
    noise = np.random.default_rng(0).normal(0.0, 0.01, 60)
    usual = dict.fromkeys(tool.COLUMNS, np.ones(60)) | {
        "host_mb": np.full(60, 800.0),
        "mean_reward": 1.0 + noise,
        "steps_per_s": 5000.0 * (1.0 + noise),
        "nonfinite_worlds": np.zeros(60),
    }
    values = usual | columns
    return [{name: float(values[name][k]) for name in tool.COLUMNS} for k in range(60)]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({}, None),
        ({"host_mb": np.linspace(800.0, 900.0, 60)}, "host_mb: grew from 820 to 900"),
        ({"host_mb": np.r_[np.linspace(500.0, 800.0, 12), np.full(48, 800.0)]}, None),  # while it starts
        ({"mean_reward": np.linspace(1.0, 0.8, 60)}, "mean_reward: went from 0.93"),
        ({"steps_per_s": np.linspace(5000.0, 3000.0, 60)}, "steps_per_s: went from "),
        ({"mean_reward": np.random.default_rng(1).normal(0.0, 1.0, 60)}, None),
        ({"nonfinite_worlds": np.arange(60.0)}, "59 worlds were not finite"),
        ({"largest_obs": np.r_[np.ones(59), np.nan]}, "largest_obs: is not finite"),
        ({"largest_q": np.r_[np.inf, np.ones(59)]}, "largest_q: is not finite"),
    ],
)
def test_problems(columns, message):
    found = tool.problems(rows(**columns))
    assert len(found) == (message is not None)
    assert not found or found[0].startswith(message)


@pytest.mark.parametrize("more", [[], ["--train"]])
def test_a_short_soak(tmp_path, monkeypatch, more):
    words = [*more, "--device", "cpu", "--num-envs", "4", "--steps", "40", "--seconds", "0.5", "--interval", "0.1"]
    monkeypatch.setattr(sys, "argv", ["soak.py", str(tmp_path), "--task", "Stripe-Cartpole-v0", *words])
    tool.main()  # whose verdict depends on what else the machine does
    with open(tmp_path / "soak.csv") as file:
        found = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert found[-1]["seconds"] >= 0.5
    assert found[-1]["steps"] >= 40
    assert found[-1]["simulated_s"] == pytest.approx(found[-1]["steps"] / 4 / 60)
    assert found[-1]["largest_obs"] > 0.0
    assert (tmp_path / "soak.png").stat().st_size > 1000
    assert (tmp_path / "soak.md").read_text().count("\n") <= 12
