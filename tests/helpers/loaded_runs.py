# SPDX-License-Identifier: Apache-2.0
"""Loaded runs: with given values, or of folders that differ in a field."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stripe_newton.rl.experiments.loaded_runs import LoadedRun, load_run
from tests.helpers.run_files import REWARD, write_run


def loaded(values, steps=None, seconds=None, config=None, name: str = "r") -> LoadedRun:
    count = len(values)
    x = {
        "iterations": np.arange(1.0, count + 1.0),
        "steps": np.arange(1.0, count + 1.0) * 100.0 if steps is None else np.asarray(steps, dtype=float),
        "seconds": np.arange(1.0, count + 1.0) if seconds is None else np.asarray(seconds, dtype=float),
    }
    return LoadedRun(Path(name), x, {REWARD: np.asarray(values, dtype=float)}, config or {})


# -- groups, metrics, differences


def runs_of(**gammas: tuple[float, ...]) -> list[LoadedRun]:
    """Runs ``NAME_SEED`` with ``algorithm.gamma``."""
    return [
        load_run(write_run(f"{name}_{seed}", [gamma], seed, agent={"algorithm": {"gamma": gamma}}))
        for name, values in gammas.items()
        for seed, gamma in enumerate(values)
    ]
