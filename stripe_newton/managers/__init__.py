# SPDX-License-Identifier: Apache-2.0
"""Managers: terms of one kind each, made into kernels."""

from stripe_newton.fusion import SceneEntityCfg, TermState

from .context import ManagerContext
from .manager_base import ManagerBase
from .reward_manager import RewardManager, RewardTermCfg
from .termination_manager import TerminationManager, TerminationTermCfg

__all__ = [
    "ManagerBase",
    "ManagerContext",
    "RewardManager",
    "RewardTermCfg",
    "SceneEntityCfg",
    "TermState",
    "TerminationManager",
    "TerminationTermCfg",
]
