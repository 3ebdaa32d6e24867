# SPDX-License-Identifier: Apache-2.0
"""Locomotion: an ant or a humanoid runs forward.

The package itself exports the direct form, from which the other forms take their numbers.
"""

from .direct import (
    AntEnv,
    AntEnvCfg,
    AntPPORunnerCfg,
    HumanoidEnv,
    HumanoidEnvCfg,
    HumanoidPPORunnerCfg,
    LocomotionEnv,
    LocomotionEnvCfg,
    LocomotionPPORunnerCfg,
)

__all__ = [
    "AntEnv",
    "AntEnvCfg",
    "AntPPORunnerCfg",
    "HumanoidEnv",
    "HumanoidEnvCfg",
    "HumanoidPPORunnerCfg",
    "LocomotionEnv",
    "LocomotionEnvCfg",
    "LocomotionPPORunnerCfg",
]
