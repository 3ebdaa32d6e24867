# SPDX-License-Identifier: Apache-2.0
"""Velocity tasks: a quadruped or a humanoid walks as commanded.

The package itself exports the configs that the manager-based forms share.
"""

from .manager_based import (
    RoughSceneCfg,
    VelocityEnvCfg,
    VelocityPPORunnerCfg,
    VelocityRoughEnvCfg,
    VelocityRoughPPORunnerCfg,
    VelocitySceneCfg,
)
from .manager_terms import (
    ActionsCfg,
    CommandsCfg,
    CurriculumCfg,
    EventsCfg,
    ObservationsCfg,
    ProprioceptionCfg,
    RewardsCfg,
    RoughEventsCfg,
    RoughObservationsCfg,
    RoughTerminationsCfg,
    ScanningCfg,
    TerminationsCfg,
)

__all__ = [
    "ActionsCfg",
    "CommandsCfg",
    "CurriculumCfg",
    "EventsCfg",
    "ObservationsCfg",
    "ProprioceptionCfg",
    "RewardsCfg",
    "RoughEventsCfg",
    "RoughObservationsCfg",
    "RoughSceneCfg",
    "RoughTerminationsCfg",
    "ScanningCfg",
    "TerminationsCfg",
    "VelocityEnvCfg",
    "VelocityPPORunnerCfg",
    "VelocityRoughEnvCfg",
    "VelocityRoughPPORunnerCfg",
    "VelocitySceneCfg",
]
