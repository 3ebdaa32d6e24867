# SPDX-License-Identifier: Apache-2.0
"""Managers: terms of one kind each, made into kernels."""

from stripe_newton.fusion import SceneEntityCfg, TermState

from .action_manager import ActionManager
from .actions_cfg import ActionTermCfg
from .command_manager import CommandManager
from .commands_cfg import CommandTermCfg
from .context import ManagerContext
from .curriculum_manager import CurriculumManager, CurriculumTermCfg
from .episode_file import EpisodeFile
from .event_cfg import EventTermCfg
from .event_manager import EventManager, prestartup_events
from .manager_base import ManagerBase
from .metrics_manager import MetricsManager, MetricTermCfg
from .object_cfg import ObjectPoolCfg, spawn_object_pools
from .object_manager import ObjectManager, ObjectPool
from .observation_cfg import (
    DigitalFilterCfg,
    IntegratorCfg,
    ModifierCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RunningNormCfg,
)
from .observation_manager import ObservationManager
from .recorder_cfg import DatasetExportMode, RecorderManagerBaseCfg, RecorderTermCfg
from .recorder_manager import RecorderManager
from .recorders import ActionStateRecorderManagerCfg, RecorderTerm
from .reward_manager import RewardManager, RewardTermCfg
from .termination_manager import TerminationManager, TerminationTermCfg

__all__ = [
    "ActionManager",
    "ActionStateRecorderManagerCfg",
    "ActionTermCfg",
    "CommandManager",
    "CommandTermCfg",
    "CurriculumManager",
    "CurriculumTermCfg",
    "DatasetExportMode",
    "DigitalFilterCfg",
    "EpisodeFile",
    "EventManager",
    "EventTermCfg",
    "IntegratorCfg",
    "ManagerBase",
    "ManagerContext",
    "MetricTermCfg",
    "MetricsManager",
    "ModifierCfg",
    "ObjectManager",
    "ObjectPool",
    "ObjectPoolCfg",
    "ObservationGroupCfg",
    "ObservationManager",
    "ObservationTermCfg",
    "RecorderManager",
    "RecorderManagerBaseCfg",
    "RecorderTerm",
    "RecorderTermCfg",
    "RewardManager",
    "RewardTermCfg",
    "RunningNormCfg",
    "SceneEntityCfg",
    "TermState",
    "TerminationManager",
    "TerminationTermCfg",
    "prestartup_events",
    "spawn_object_pools",
]
