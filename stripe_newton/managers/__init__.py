# SPDX-License-Identifier: Apache-2.0
"""Managers: terms of one kind each, turned into the items of a step."""

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
from .modifiers import DigitalFilterCfg, IntegratorCfg, ModifierCfg
from .normalization import RunningNormCfg
from .object_manager import ObjectManager
from .object_pool import ObjectPool, ObjectPoolCfg, spawn_object_pools
from .observation_manager import ObservationManager
from .observation_term import ObservationGroupCfg, ObservationTermCfg
from .recorder_manager import DatasetExportMode, RecorderManager, RecorderManagerBaseCfg
from .recorder_term import RecorderTerm, RecorderTermCfg
from .recorders import ActionStateRecorderManagerCfg
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
