# SPDX-License-Identifier: Apache-2.0
"""Recorder term: base of the terms that record data at four points of a step."""

from __future__ import annotations

from typing import Any, ClassVar

import torch

from stripe_newton.configclass import MISSING, configclass

from .episode_file import Episode

__all__ = ["Recorded", "RecorderTerm", "RecorderTermCfg"]

Recorded = tuple[str | None, torch.Tensor | Episode | None]
"""Key and value: a tensor, or nested dicts of tensors. The key may be a path, ``"obs/joint_pos"``; None for nothing."""


@configclass
class RecorderTermCfg:
    """Config of a recorder term."""

    MAY_BE_NONE: ClassVar[bool] = True

    class_type: type = MISSING
    """Subclass of :class:`RecorderTerm`, made with this config and the environment."""


class RecorderTerm:
    """Base of recorder terms. Its methods run at four points of a step; a subclass overrides those it needs.

    Results are copied at once, so views of the simulation's memory are allowed. The methods before and after a step
    return one row for each environment, those around a reset one row for each of ``env_ids``.
    """

    def __init__(self, cfg: RecorderTermCfg, env: Any):
        """Keep config and environment."""
        self.cfg, self._env = cfg, env

    def record_pre_step(self) -> Recorded:
        """Data after the actions are processed, before the physics."""
        return None, None

    def record_post_step(self) -> Recorded:
        """Data after physics and rewards, before environments are reset."""
        return None, None

    def record_pre_reset(self, env_ids: torch.Tensor) -> Recorded:
        """Data at the end of episodes, before environments are reset; ``env_ids`` is int64."""
        return None, None

    def record_post_reset(self, env_ids: torch.Tensor) -> Recorded:
        """Data at the start of episodes, after environments are reset; ``env_ids`` is int64."""
        return None, None
