# SPDX-License-Identifier: Apache-2.0
"""Manager-based velocity tasks of the quadruped: ``Stripe-Velocity-Flat-Quadruped-v0`` and ``...-Rough-...``.

Weights of the rewards follow Isaac Lab's for robots of this size.
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
    end_on_contact,
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
    """Rewards of the quadruped: only its feet may touch the ground."""

    def __post_init__(self) -> None:
        if self.feet_air_time is not None:
            self.feet_air_time.params["sensor_cfg"] = contacts(".*_foot")
        if self.undesired_contacts is not None:
            self.undesired_contacts.params["sensor_cfg"] = contacts(".*_thigh", ".*_calf")


@configclass
class QuadrupedFlatEnvCfg(VelocityEnvCfg):
    """Quadruped on a plane: 48 observations, 12 joint positions."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    rewards: QuadrupedRewardsCfg = QuadrupedRewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()

    def __post_init__(self) -> None:
        randomize(self.events, "base", ".*_foot")
        end_on_contact(self.terminations, "base")


@configclass
class QuadrupedFlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for the quadruped on a plane."""

    experiment_name: str = "velocity_flat_quadruped"


@configclass
class QuadrupedRoughEnvCfg(VelocityRoughEnvCfg):
    """Quadruped on rough ground: 235 observations, 187 of them heights."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    rewards: QuadrupedRewardsCfg = QuadrupedRewardsCfg()
    terminations: RoughTerminationsCfg = RoughTerminationsCfg()
    events: RoughEventsCfg = RoughEventsCfg()

    def __post_init__(self) -> None:
        randomize(self.events, "base", ".*_foot")
        end_on_contact(self.terminations, "base")
        self.scene.height_scanner.prim_path = "{ENV_REGEX_NS}/Robot/base"
        if self.scene.terrain.terrain_generator is not None:
            # steps and bumps that a robot with legs of 0.4 m can climb
            tiles = self.scene.terrain.terrain_generator.sub_terrains
            tiles["boxes"].grid_height_range = (0.025, 0.1)
            tiles["random_rough"].noise_range, tiles["random_rough"].noise_step = (0.01, 0.06), 0.01
        self.rewards.flat_orientation_l2 = None  # a body that stays level could not climb slopes


@configclass
class QuadrupedRoughPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO for the quadruped on rough ground."""

    experiment_name: str = "velocity_rough_quadruped"
