# SPDX-License-Identifier: Apache-2.0
"""Reach: an arm brings its flange to a commanded pose."""

from .manager_based import (
    ActionsCfg,
    CommandsCfg,
    CurriculumCfg,
    EventsCfg,
    ObservationsCfg,
    ReachEnv,
    ReachEnvCfg,
    ReachPPORunnerCfg,
    ReachSceneCfg,
    RewardsCfg,
    TerminationsCfg,
)

__all__ = [
    "ActionsCfg",
    "CommandsCfg",
    "CurriculumCfg",
    "EventsCfg",
    "ObservationsCfg",
    "ReachEnv",
    "ReachEnvCfg",
    "ReachPPORunnerCfg",
    "ReachSceneCfg",
    "RewardsCfg",
    "TerminationsCfg",
]
