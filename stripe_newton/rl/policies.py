# SPDX-License-Identifier: Apache-2.0
"""What chooses actions: the protocol of a policy, and two that need no training."""

from __future__ import annotations

from typing import Protocol

import torch
from tensordict import TensorDict

from .vec_env import RslRlVecEnvWrapper

__all__ = ["Policy", "RandomPolicy", "ZeroPolicy"]


class Policy(Protocol):
    """Maps observations to actions (num_envs, num_actions). rsl_rl's networks are policies."""

    def __call__(self, obs: TensorDict) -> torch.Tensor:
        """The actions for ``obs``."""

    def reset(self, dones: torch.Tensor | None = None) -> None:
        """Forget the past of the environments whose episode ended, ``dones`` (num_envs,), or of all."""


class ZeroPolicy:
    """Always zero."""

    def __init__(self, env: RslRlVecEnvWrapper):
        self._actions = torch.zeros(env.num_envs, env.num_actions, device=env.device)

    def __call__(self, obs: TensorDict) -> torch.Tensor:
        return self._actions.clone()

    def reset(self, dones: torch.Tensor | None = None) -> None:
        """Nothing to forget."""


class RandomPolicy:
    """Uniform over the action space; [-1, 1] for an action without bounds."""

    def __init__(self, env: RslRlVecEnvWrapper):
        space = env.unwrapped.single_action_space
        low, high = (
            torch.as_tensor(bound, dtype=torch.float32, device=env.device) for bound in (space.low, space.high)
        )
        bounded = low.isfinite() & high.isfinite()
        self._low = torch.where(bounded, low, -torch.ones_like(low))
        self._span = torch.where(bounded, high, torch.ones_like(high)) - self._low
        self._shape = (env.num_envs, env.num_actions)

    def __call__(self, obs: TensorDict) -> torch.Tensor:
        return self._low + self._span * torch.rand(self._shape, device=self._low.device)

    def reset(self, dones: torch.Tensor | None = None) -> None:
        """Nothing to forget."""
