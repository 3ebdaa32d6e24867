# SPDX-License-Identifier: Apache-2.0
"""TorchVectorEnv: the interface that training needs of an environment, and the parts that only some have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard

import gymnasium
import numpy as np
import torch

if TYPE_CHECKING:
    from stripe_newton.configclass import Config
    from stripe_newton.envs import RLEnv
    from stripe_newton.sim import Simulation

__all__ = [
    "EnvState",
    "Extras",
    "Observations",
    "Resumable",
    "Simulated",
    "TorchVectorEnv",
    "is_finite_horizon",
    "is_resumable",
    "is_simulated",
    "rl_env_of",
    "success_of",
]

Observations = Mapping[str, torch.Tensor]
"""Observations by group, each of shape ``(num_envs, ...)``."""
Extras = dict[str, Any]
"""Further results of a step: ``"log"``, ``"time_outs"``, ``"final_obs"``, and values of the task's own."""
EnvState = dict[str, Any]
"""State of an environment, nested dicts of tensors and plain values. Each kind of environment has its own keys."""


class TorchVectorEnv(Protocol):
    """A vector environment of torch tensors that resets within its step, or a gymnasium wrapper around one.

    :class:`~stripe_newton.envs.RLEnv` and :class:`~stripe_newton.envs.SingleAgentView` are such environments. Those of
    other packages that are train too, with rsl_rl's own rollout.
    """

    episode_length_buf: torch.Tensor
    """Steps in the current episode, int64 ``(num_envs,)``."""

    @property
    def num_envs(self) -> int:
        """Number of environments."""

    @property
    def device(self) -> str:
        """Device of all tensors."""

    @property
    def cfg(self) -> Config:
        """Config of the environment."""

    @property
    def single_observation_space(self) -> gymnasium.spaces.Dict:
        """Observation space of one environment, by group."""

    @property
    def single_action_space(self) -> gymnasium.Space:
        """Action space of one environment."""

    @property
    def max_episode_length(self) -> int:
        """Steps after which the clock ends an episode."""

    @property
    def step_dt(self) -> float:
        """Duration of a step [s]."""

    @property
    def unwrapped(self) -> TorchVectorEnv:
        """The environment without gymnasium's wrappers."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Extras]:
        """Begin new episodes. Returns observations and extras."""

    def step(self, action: torch.Tensor) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        """Take a step. Returns observations, rewards, terminated, truncated and extras."""

    def render(self) -> np.ndarray | None:
        """A picture, uint8 ``(height, width, 3)``."""

    def close(self) -> None:
        """Release what the environment holds."""


class Resumable(Protocol):
    """An environment whose state can be saved and restored, so that a run resumes within its episodes."""

    def get_state(self) -> EnvState:
        """All that the next step depends on."""

    def set_state(self, state: EnvState) -> None:
        """Go on from what :meth:`get_state` returned."""


class Simulated(Protocol):
    """An environment with a simulation, which a viewer can show."""

    @property
    def sim(self) -> Simulation:
        """The simulation."""


# A view of another environment, such as `SingleAgentView`, hands attributes on by `__getattr__`. `isinstance` with a
# runtime-checkable protocol does not see those from Python 3.12 on, `hasattr` does.


def is_resumable(env: TorchVectorEnv) -> TypeGuard[Resumable]:
    """Whether an environment can save its state."""
    return hasattr(env, "get_state")


def is_simulated(env: TorchVectorEnv) -> TypeGuard[Simulated]:
    """Whether an environment has a simulation."""
    return hasattr(env, "sim")


def success_of(env: TorchVectorEnv) -> torch.Tensor | None:
    """Whether the episodes that ended in the last step were successes, bool ``(num_envs,)``.

    It is the attribute ``success`` of the environment; None where the task does not define one.
    """
    return getattr(env, "success", None)


def is_finite_horizon(env: TorchVectorEnv) -> bool:
    """Whether the time limit is part of the task, so that nothing of value follows it.

    It is the field ``is_finite_horizon`` of the config; False where the config has no such field.
    """
    return bool(getattr(env.cfg, "is_finite_horizon", False))


def rl_env_of(env: TorchVectorEnv) -> RLEnv | None:
    """The :class:`RLEnv` that ``env`` is or shows as one agent; None for an environment of another package."""
    # Importing environments loads Newton, which takes seconds; commands that print their help have no use for it.
    from stripe_newton.envs import RLEnv, SingleAgentView

    # A view hands attributes on, but is no RLEnv itself.
    inner = env.env if isinstance(env, SingleAgentView) else env
    return inner if isinstance(inner, RLEnv) else None
