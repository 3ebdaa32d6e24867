# SPDX-License-Identifier: Apache-2.0
"""A quadruped of 15 kg walks as commanded, on flat and on rough ground: ``Stripe-Velocity-{Flat,Rough}-Quadruped-v0``.

Weights follow those that Isaac Lab has for robots of this class.
"""

from __future__ import annotations

from stripe_newton.configclass import configclass
from stripe_tasks.robots import QUADRUPED_CFG

from .manager_based import (
    EventsCfg,
    RewardsCfg,
    RoughEventsCfg,
    RoughSceneCfg,
    RoughTerminationsCfg,
    TerminationsCfg,
    VelocityEnvCfg,
    VelocityPPORunnerCfg,
    VelocityRoughEnvCfg,
    VelocityRoughPPORunnerCfg,
    VelocitySceneCfg,
    contacts,
    randomize,
)

__all__ = [
    "QuadrupedFlatEnvCfg",
    "QuadrupedFlatPPORunnerCfg",
    "QuadrupedRoughEnvCfg",
    "QuadrupedRoughPPORunnerCfg",
]

ROBOT_CFG = QUADRUPED_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")


@configclass
class QuadrupedRewardsCfg(RewardsCfg):
    """Steps are taken by the feet alone."""

    def __post_init__(self) -> None:
        if self.feet_air_time is not None:
            self.feet_air_time.params["sensor_cfg"] = contacts(".*_foot")
        if self.undesired_contacts is not None:
            self.undesired_contacts.params["sensor_cfg"] = contacts(".*_thigh", ".*_calf")


@configclass
class QuadrupedFlatEnvCfg(VelocityEnvCfg):
    """48 observations, 12 joint positions, on a plane."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    rewards: QuadrupedRewardsCfg = QuadrupedRewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()

    def __post_init__(self) -> None:
        randomize(self.events, "base", ".*_foot")
        self.terminations.base_contact.params["sensor_cfg"] = contacts("base")


@configclass
class QuadrupedFlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO that makes the quadruped walk on a plane."""

    experiment_name: str = "velocity_flat_quadruped"


@configclass
class QuadrupedRoughEnvCfg(VelocityRoughEnvCfg):
    """235 observations, 187 of them heights; ten levels of ground, whose steps are as high as this robot can climb."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    rewards: QuadrupedRewardsCfg = QuadrupedRewardsCfg()
    terminations: RoughTerminationsCfg = RoughTerminationsCfg()
    events: RoughEventsCfg = RoughEventsCfg()

    def __post_init__(self) -> None:
        randomize(self.events, "base", ".*_foot")
        self.terminations.base_contact.params["sensor_cfg"] = contacts("base")
        self.scene.height_scanner.prim_path = "{ENV_REGEX_NS}/Robot/base"
        if self.scene.terrain.terrain_generator is not None:
            tiles = self.scene.terrain.terrain_generator.sub_terrains
            tiles["boxes"].grid_height_range = (0.025, 0.1)
            tiles["random_rough"].noise_range, tiles["random_rough"].noise_step = (0.01, 0.06), 0.01
        self.rewards.flat_orientation_l2 = None  # slopes are to be climbed


@configclass
class QuadrupedRoughPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO that makes the quadruped walk on rough ground."""

    experiment_name: str = "velocity_rough_quadruped"
