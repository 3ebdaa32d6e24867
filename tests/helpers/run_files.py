# SPDX-License-Identifier: Apache-2.0
"""Run folders as a training leaves them, written without one."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from stripe_newton.rl.runs.run_folder import RunFolder

REWARD = "Train/mean_reward"


def write_run(
    path: str | Path, rewards, seed: int = 1, seconds_each: float = 2.0, agent=None, env=None, **columns
) -> Path:
    """A run folder as training leaves it: 100 samples an iteration."""
    run = RunFolder(path)
    run.path.mkdir(parents=True)
    env_cfg = {"seed": seed, "sim": {"device": "cuda:0", "dt": 0.01}, "scene": {"num_envs": 10}} | (env or {})
    agent_cfg = {"seed": seed, "experiment_name": "fake", "num_steps_per_env": 10, "run_name": ""} | (agent or {})
    run.write_params(env_cfg, agent_cfg)
    run.write_task("Fake-v0")
    logged = {REWARD: rewards} | columns
    with open(run.metrics, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", "total_steps", "elapsed_s", *logged])
        for at in range(len(rewards)):
            row = [values[at] for values in logged.values()]
            head = [at, 100 * (at + 1), 2.0 * (at + 1)]
            writer.writerow([*head, *("" if value is None or math.isnan(value) else value for value in row)])
    return run.path
