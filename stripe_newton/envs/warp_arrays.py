# SPDX-License-Identifier: Apache-2.0
"""Warp arrays of a direct environment: what its Warp hooks read and write."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field, fields
from typing import NoReturn

import warp as wp

from stripe_kernels.data import EpisodeData
from stripe_newton.fusion.episode_log import EpisodeLog

__all__ = ["WarpArrays"]


@dataclass
class WarpArrays:
    """Arrays of a direct environment for its kernels, as ``env.warp``.

    A subclass may keep arrays of its own here, under other names.
    """

    actions: wp.array
    """Actions of the step, float, shape ``(num_envs, num_actions)``."""
    terminated: wp.array
    """Whether the episode ends in failure or success, bool, shape ``(num_envs,)``; ``_launch_dones`` writes it."""
    truncated: wp.array
    """Whether the episode is cut off, bool, shape ``(num_envs,)``; ``_launch_dones`` writes it."""
    reset: wp.array
    """Whether the episode ended in this step, bool, shape ``(num_envs,)``."""
    reward: wp.array
    """Rewards of the step, float, shape ``(num_envs,)``; ``_launch_rewards`` writes it."""
    episode: EpisodeData
    """Struct for kernels: steps so far, the ends above, and the length of an episode."""
    rng: wp.array
    """Random streams for the functions of ``stripe_kernels.mdp.random``, uint32, shape ``(num_envs,)``."""
    step: wp.array
    """Environment steps taken, int64, shape ``(1,)``."""
    log: EpisodeLog
    """Log of the step."""
    observations: dict[str, wp.array] = field(default_factory=dict)
    """Observations by group, float, shape ``(num_envs, size)``; ``_launch_observations`` writes them."""

    def __getattr__(self, name: str) -> NoReturn:
        known = [entry.name for entry in fields(self)]
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
        hint = f"did you mean {near[0]}? " if near else ""
        raise AttributeError(f"env.warp has no '{name}'; {hint}it has {', '.join(known)}")
