# SPDX-License-Identifier: Apache-2.0
"""Cart-pole with short episodes, in the adapter for Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import numpy as np

from stripe_newton.rl.wrappers.sb3 import Sb3VecEnvWrapper
from tests.helpers.learner_examples import cartpole

N = 4
SHORT = 12
"""Steps of the episodes."""


def wrapped(num_envs: int = N, obs_group: Any = "policy", clip_actions: float | None = None, **changes: Any) -> Any:
    changes = {"episode_length_s": SHORT / 60.0, "compute_final_obs": True} | changes
    return Sb3VecEnvWrapper(cartpole(num_envs, **changes), obs_group, clip_actions)


def push(step: int) -> np.ndarray:
    """Actions that differ by environment and step, shape ``(N, 1)``."""
    return np.sin(np.arange(N, dtype=np.float32) + step)[:, None]
