# SPDX-License-Identifier: Apache-2.0
"""Recorder term: what is recorded at four points of a step."""

from __future__ import annotations

from typing import Any

import torch

from stripe_newton.configclass import MISSING, configclass

from .episode_file import Episode

__all__ = ["Recorded", "RecorderTerm", "RecorderTermCfg"]

Recorded = tuple[str | None, torch.Tensor | Episode | None]
"""Key and value: a tensor, or nested dicts of tensors. The key may be a path, ``"obs/joint_pos"``; None for nothing."""


@configclass
class RecorderTermCfg:
    """One thing to record."""

    class_type: type = MISSING
    """Subclass of :class:`RecorderTerm`, made with this config and the environment."""


class RecorderTerm:
    """Says what to record at four points of a step; a subclass overrides those it needs.

    What is returned is copied at once, so a view of the simulation's memory may be returned as it is. The calls before
    and after a step return one row an environment, those around a reset one row for each of ``env_ids``.
    """

    def __init__(self, cfg: RecorderTermCfg, env: Any):
        """Keep config and environment."""
        self.cfg, self._env = cfg, env

    def record_pre_step(self) -> Recorded:
        """After the actions were processed, before physics."""
        return None, None

    def record_post_step(self) -> Recorded:
        """After physics and rewards, before environments are reset."""
        return None, None

    def record_pre_reset(self, env_ids: torch.Tensor) -> Recorded:
        """Before environments are reset, at the end of their episodes; ``env_ids`` is int64."""
        return None, None

    def record_post_reset(self, env_ids: torch.Tensor) -> Recorded:
        """After environments were reset, at the start of their episodes; ``env_ids`` is int64."""
        return None, None
