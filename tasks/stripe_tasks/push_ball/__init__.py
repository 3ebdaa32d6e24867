# SPDX-License-Identifier: Apache-2.0
"""Push ball: an ant pushes a ball to a goal."""

from .manager_based import (
    EventsCfg,
    MetricsCfg,
    ObjectsCfg,
    ObservationsCfg,
    PushBallEnv,
    PushBallEnvCfg,
    PushBallPPORunnerCfg,
    PushBallSceneCfg,
    RewardsCfg,
    TerminationsCfg,
)

__all__ = [
    "EventsCfg",
    "MetricsCfg",
    "ObjectsCfg",
    "ObservationsCfg",
    "PushBallEnv",
    "PushBallEnvCfg",
    "PushBallPPORunnerCfg",
    "PushBallSceneCfg",
    "RewardsCfg",
    "TerminationsCfg",
]
