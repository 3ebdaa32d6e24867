# SPDX-License-Identifier: Apache-2.0
"""A humanoid runs forward: ``Stripe-Humanoid-Direct-v0``."""

from __future__ import annotations

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_tasks.locomotion import LocomotionEnv, LocomotionEnvCfg, LocomotionPPORunnerCfg
from stripe_tasks.robots import HUMANOID_CFG

__all__ = ["HumanoidEnv", "HumanoidEnvCfg", "HumanoidPPORunnerCfg"]


@configclass
class HumanoidEnvCfg(LocomotionEnvCfg):
    """75 observations, 21 joint torques."""

    observation_space: int = 75
    action_space: int = 21
    robot: ArticulationCfg = HUMANOID_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    joint_gears: dict[str, float] = {
        "lower_waist:.": 67.5,
        "abdomen_x": 67.5,
        ".*_upper_arm:.": 67.5,
        ".*_elbow": 45.0,
        ".*_thigh:[02]": 45.0,
        ".*_thigh:1": 135.0,
        ".*_knee": 90.0,
        ".*_foot:.": 22.5,
    }
    alive_reward: float = 2.0
    death_cost: float = -1.0
    actions_cost: float = 0.01
    joint_vel_scale: float = 0.1
    ang_vel_scale: float = 0.25
    termination_height: float = 0.8


class HumanoidEnv(LocomotionEnv):
    """See :class:`LocomotionEnv`."""

    cfg: HumanoidEnvCfg


@configclass
class HumanoidPPORunnerCfg(LocomotionPPORunnerCfg):
    """PPO that makes the humanoid run."""

    max_iterations: int = 500
    experiment_name: str = "humanoid_direct"
