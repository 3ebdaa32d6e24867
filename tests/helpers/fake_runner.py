# SPDX-License-Identifier: Apache-2.0
"""Runners that train the fake cart, and readers of the files that they leave."""

from __future__ import annotations

import csv
import random
from pathlib import Path

import numpy as np
import torch

from stripe_newton.rl import (
    OnPolicyRunner,
    RslRlMLPModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlRndCfg,
    RslRlRNNModelCfg,
    RslRlVecEnvWrapper,
)
from tests.helpers.fake_env import FakeCartCfg, FakeCartEnv, FakeCartRunnerCfg


def make_env(
    num_envs: int = 8, clip_actions: float | None = None, device: str = "cpu", **changes
) -> RslRlVecEnvWrapper:
    cfg = FakeCartCfg()
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = device, num_envs, 3
    return RslRlVecEnvWrapper(FakeCartEnv(cfg.replace(**changes), "rgb_array"), clip_actions)


def make_runner(
    folder: Path | None, agent: RslRlOnPolicyRunnerCfg | None = None, num_envs: int = 8, device: str = "cpu"
) -> OnPolicyRunner:
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    torch.manual_seed(1)
    return OnPolicyRunner(make_env(num_envs, device=device), agent or FakeCartRunnerCfg(), folder)


def rnn_cfg() -> RslRlOnPolicyRunnerCfg:
    agent = FakeCartRunnerCfg()
    agent.actor = RslRlRNNModelCfg(
        hidden_dims=(8,), rnn_hidden_dim=6, distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg()
    )
    agent.critic = RslRlRNNModelCfg(hidden_dims=(8,), rnn_hidden_dim=6, rnn_type="gru")
    return agent


def rnd_cfg() -> RslRlOnPolicyRunnerCfg:
    agent = FakeCartRunnerCfg()
    agent.obs_groups["rnd_state"] = ["policy"]
    schedule = {"mode": "linear", "initial_step": 10, "final_step": 80, "final_value": 0.1}
    agent.algorithm.rnd_cfg = RslRlRndCfg(
        weight=5.0, state_normalization=True, reward_normalization=True, weight_schedule=schedule
    )
    return agent


def flat(state: dict, path: str = "") -> dict:
    """Leaves of a checkpoint by their path."""
    leaves = {}
    for key, value in state.items():
        if isinstance(value, dict):
            leaves |= flat(value, f"{path}{key}/")
        elif isinstance(value, (list, tuple)):
            leaves |= flat(dict(enumerate(value)), f"{path}{key}/")
        else:
            leaves[f"{path}{key}"] = value
    return leaves


def rows(folder: Path) -> list[dict[str, str]]:
    with open(folder / "metrics.csv", newline="") as file:
        return list(csv.DictReader(file))
