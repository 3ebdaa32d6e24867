# SPDX-License-Identifier: Apache-2.0
"""Managers: terms of one kind each, turned into the items of a step."""

from stripe_newton.fusion import SceneEntityCfg, TermState

from .action_manager import ActionManager
from .action_term import ActionTerm, KernelActionTerm
from .actions_cfg import ActionManagerCfg, ActionTermCfg
from .command_manager import CommandManager
from .command_term import CommandTerm, KernelCommandTerm
from .commands_cfg import CommandManagerCfg, CommandTermCfg
from .context import ManagerContext
from .curriculum_manager import CurriculumManager, CurriculumManagerCfg, CurriculumTermCfg
from .custom_manager import CustomManager, CustomManagerCfg
from .episode_file import EpisodeFile
from .event_cfg import EventManagerCfg, EventTermCfg
from .event_manager import EventManager, prestartup_events
from .manager_base import ManagerBase
from .metrics_manager import MetricsManager, MetricsManagerCfg, MetricTermCfg
from .modifiers import DigitalFilterCfg, IntegratorCfg, ModifierBase, ModifierCfg
from .normalization import RunningNormCfg
from .object_manager import ObjectManager
from .object_pool import ObjectManagerCfg, ObjectPool, ObjectPoolCfg, spawn_object_pools
from .observation_manager import ObservationManager
from .observation_term import ObservationGroupCfg, ObservationManagerCfg, ObservationTermCfg
from .recorder_manager import DatasetExportMode, RecorderManager, RecorderManagerBaseCfg
from .recorder_term import RecorderTerm, RecorderTermCfg
from .recorders import ActionStateRecorderManagerCfg
from .reward_manager import RewardManager, RewardManagerCfg, RewardTermCfg
from .term_class import ManagerTermBase, TermEnv
from .term_evaluation import TermEvaluation
from .term_manager import TermManager
from .termination_manager import TerminationManager, TerminationManagerCfg, TerminationTermCfg

__all__ = [
    "ActionManager",
    "ActionManagerCfg",
    "ActionStateRecorderManagerCfg",
    "ActionTerm",
    "ActionTermCfg",
    "CommandManager",
    "CommandManagerCfg",
    "CommandTerm",
    "CommandTermCfg",
    "CurriculumManager",
    "CurriculumManagerCfg",
    "CurriculumTermCfg",
    "CustomManager",
    "CustomManagerCfg",
    "DatasetExportMode",
    "DigitalFilterCfg",
    "EpisodeFile",
    "EventManager",
    "EventManagerCfg",
    "EventTermCfg",
    "IntegratorCfg",
    "KernelActionTerm",
    "KernelCommandTerm",
    "ManagerBase",
    "ManagerContext",
    "ManagerTermBase",
    "MetricTermCfg",
    "MetricsManager",
    "MetricsManagerCfg",
    "ModifierBase",
    "ModifierCfg",
    "ObjectManager",
    "ObjectManagerCfg",
    "ObjectPool",
    "ObjectPoolCfg",
    "ObservationGroupCfg",
    "ObservationManager",
    "ObservationManagerCfg",
    "ObservationTermCfg",
    "RecorderManager",
    "RecorderManagerBaseCfg",
    "RecorderTerm",
    "RecorderTermCfg",
    "RewardManager",
    "RewardManagerCfg",
    "RewardTermCfg",
    "RunningNormCfg",
    "SceneEntityCfg",
    "TermEnv",
    "TermEvaluation",
    "TermManager",
    "TermState",
    "TerminationManager",
    "TerminationManagerCfg",
    "TerminationTermCfg",
    "prestartup_events",
    "spawn_object_pools",
]
