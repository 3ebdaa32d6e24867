# SPDX-License-Identifier: Apache-2.0
"""Manager-based velocity tasks of the quadruped: ``Stripe-Velocity-Flat-Quadruped-v0`` and ``...-Rough-...``.

Weights of the rewards follow Isaac Lab's for robots of this size.
"""

from __future__ import annotations

from stripe_newton.configclass import configclass
from stripe_tasks.robots import QUADRUPED_CFG

from .manager_based import (
    ROBOT_PATH,
    BodyNames,
    RoughSceneCfg,
    VelocityEnvCfg,
    VelocityPPORunnerCfg,
    VelocityRoughEnvCfg,
    VelocityRoughPPORunnerCfg,
    VelocitySceneCfg,
)

__all__ = [
    "QuadrupedFlatEnvCfg",
    "QuadrupedFlatPPORunnerCfg",
    "QuadrupedRoughEnvCfg",
    "QuadrupedRoughPPORunnerCfg",
]

ROBOT_CFG = QUADRUPED_CFG.replace(prim_path=ROBOT_PATH)


@configclass
class QuadrupedFlatEnvCfg(VelocityEnvCfg):
    """Quadruped on a plane: 48 observations, 12 joint positions."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    base: str = "base"
    feet: BodyNames = ".*_foot"
    thighs: BodyNames = [".*_thigh", ".*_calf"]


@configclass
class QuadrupedFlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for the quadruped on a plane."""

    experiment_name: str = "velocity_flat_quadruped"


@configclass
class QuadrupedRoughEnvCfg(VelocityRoughEnvCfg):
    """Quadruped on rough ground: 235 observations, 187 of them heights."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    base: str = "base"
    feet: BodyNames = ".*_foot"
    thighs: BodyNames = [".*_thigh", ".*_calf"]

    def __post_init__(self) -> None:
        super().__post_init__()
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
