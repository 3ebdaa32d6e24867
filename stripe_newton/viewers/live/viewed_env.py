# SPDX-License-Identifier: Apache-2.0
"""Viewed environment: what the live view reads of an environment beyond its simulation, as a protocol."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard

from stripe_newton.viewers.viewed_simulation import ViewedSimulation
from stripe_newton.viewers.viewer_cfg import ViewerCfg

if TYPE_CHECKING:
    import torch

__all__ = ["ViewedEnv", "viewer_cfg_of", "what_is_viewed"]


class ViewedEnv(Protocol):
    """An environment of this package. Managers are there for some only, and are asked for by name.

    Attributes:
        num_envs: Number of environments.
        step_dt: Duration of a step [s].
        max_episode_length: Steps in an episode.
        common_step_counter: Steps taken.
        reward_buf: Rewards of the last step, shape ``(num_envs,)``.
        reset_buf: Environments whose episode ended in it, shape ``(num_envs,)``.
        episode_length_buf: Steps in the current episodes, shape ``(num_envs,)``.
        obs_buf: Observations by group.
        extras: Extras of the last step.
    """

    num_envs: int
    step_dt: float
    max_episode_length: int
    common_step_counter: int
    reward_buf: torch.Tensor
    reset_buf: torch.Tensor
    episode_length_buf: torch.Tensor
    obs_buf: Mapping[str, Any]
    extras: Mapping[str, Any]

    @property
    def sim(self) -> ViewedSimulation:
        """The simulation."""

    def reset(self) -> object:
        """Begin new episodes."""

    def update_debug_vis(self) -> None:
        """Move markers that the environment draws itself, before a picture."""


def what_is_viewed(subject: object) -> tuple[ViewedEnv | None, ViewedSimulation]:
    """The environment, if it is one, and the simulation of what a viewer was given.

    Args:
        subject: An environment, a wrapper of one, a scene or a simulation.

    Raises:
        TypeError: it is none of these.
    """
    inner = getattr(subject, "unwrapped", subject)
    if _is_simulation(inner):
        return None, inner
    sim = getattr(inner, "sim", None)
    if not _is_simulation(sim):
        name = type(inner).__name__
        raise TypeError(f"LiveViewer: {name} has no simulation to show; give an environment, a scene or a Simulation")
    return (inner, sim) if _is_env(inner) else (None, sim)


def viewer_cfg_of(env: ViewedEnv | None) -> ViewerCfg:
    """The viewer's config of an environment; the default of anything else."""
    found = getattr(getattr(env, "cfg", None), "viewer", None)
    return found if isinstance(found, ViewerCfg) else ViewerCfg()


def _is_simulation(subject: object) -> TypeGuard[ViewedSimulation]:
    return all(hasattr(subject, name) for name in ("template", "static", "env_origins"))


def _is_env(subject: object) -> TypeGuard[ViewedEnv]:
    return all(hasattr(subject, name) for name in ("step", "reset", "reward_buf", "episode_length_buf"))
