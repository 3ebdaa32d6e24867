# SPDX-License-Identifier: Apache-2.0
"""A four-legged ant runs forward: ``Stripe-Ant-Direct-v0``."""

from __future__ import annotations

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_tasks.locomotion import LocomotionEnv, LocomotionEnvCfg, LocomotionPPORunnerCfg
from stripe_tasks.robots import ANT_CFG

__all__ = ["AntEnv", "AntEnvCfg", "AntPPORunnerCfg"]


@configclass
class AntEnvCfg(LocomotionEnvCfg):
    """36 observations, 8 joint torques."""

    observation_space: int = 36
    action_space: int = 8
    robot: ArticulationCfg = ANT_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    joint_gears: dict[str, float] = {".*": 15.0}
    action_scale: float = 0.5
    termination_height: float = 0.31


class AntEnv(LocomotionEnv):
    """See :class:`LocomotionEnv`."""

    cfg: AntEnvCfg


@configclass
class AntPPORunnerCfg(LocomotionPPORunnerCfg):
    """PPO that makes the ant run."""

    max_iterations: int = 300
    experiment_name: str = "ant_direct"
