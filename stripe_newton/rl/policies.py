# SPDX-License-Identifier: Apache-2.0
"""Policy: the protocol of what chooses actions, and two policies without training, zero and random."""

from __future__ import annotations

from typing import Protocol

import torch
from tensordict import TensorDict

from .wrappers.rsl_rl import RslRlVecEnvWrapper

__all__ = ["Policy", "RandomPolicy", "ZeroPolicy"]


class Policy(Protocol):
    """Maps observations to actions. rsl_rl's networks are policies."""

    def __call__(self, obs: TensorDict) -> torch.Tensor:
        """The actions for ``obs``, ``(num_envs, num_actions)``."""

    def reset(self, dones: torch.Tensor | None = None) -> None:
        """Clear the memory of the environments whose episode ended, ``dones`` ``(num_envs,)``, or of all."""


class ZeroPolicy:
    """Actions that are always zero."""

    def __init__(self, env: RslRlVecEnvWrapper):
        self._actions = torch.zeros(env.num_envs, env.num_actions, device=env.device)

    def __call__(self, obs: TensorDict) -> torch.Tensor:
        return self._actions.clone()  # a caller may keep it, or write into it

    def reset(self, dones: torch.Tensor | None = None) -> None:
        """There is no memory to clear."""


class RandomPolicy:
    """Actions drawn uniformly from the action space; from [-1, 1] where an action has no bounds."""

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
        """There is no memory to clear."""
