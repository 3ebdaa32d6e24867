# SPDX-License-Identifier: Apache-2.0
"""Manager-based velocity tasks of the humanoid: ``Stripe-Velocity-Flat-Humanoid-v0`` and ``...-Rough-...``.

Terms and weights of the rewards follow Isaac Lab's for bipeds.
"""

from __future__ import annotations

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import CurriculumTermCfg, RewardTermCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.robots import HUMANOID_POSITION_CFG

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
from .manager_terms import TWIST, ActionsCfg, CommandsCfg, CurriculumCfg, RewardsCfg, joints

__all__ = ["HumanoidFlatEnvCfg", "HumanoidFlatPPORunnerCfg", "HumanoidRoughEnvCfg", "HumanoidRoughPPORunnerCfg"]

ROBOT_CFG = HUMANOID_POSITION_CFG.replace(prim_path=ROBOT_PATH)
FALLS_ON = ["torso", "pelvis", "head", ".*_thigh", ".*_arm"]


@configclass
class HumanoidRewardsCfg(RewardsCfg):
    """Rewards of the humanoid: walk upright, one foot after the other, with the arms down."""

    track_lin_vel_xy_exp: RewardTermCfg = RewardTermCfg(
        func=mdp.track_lin_vel_xy_yaw_frame_exp, weight=1.5, params={**TWIST, "std": 0.5}
    )
    track_ang_vel_z_exp: RewardTermCfg = RewardTermCfg(
        func=mdp.track_ang_vel_z_world_exp, weight=1.0, params={**TWIST, "std": 0.5}
    )
    lin_vel_z_l2: RewardTermCfg = RewardTermCfg(func=mdp.lin_vel_z_l2, weight=-0.2)
    joint_torques_l2: RewardTermCfg = RewardTermCfg(func=mdp.joint_torques_l2, weight=-2.0e-6)
    joint_acc_l2: RewardTermCfg = RewardTermCfg(func=mdp.joint_acc_l2, weight=-1.25e-7)
    action_rate_l2: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.005)
    flat_orientation_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.flat_orientation_l2, weight=-1.0)
    feet_air_time: RewardTermCfg = RewardTermCfg(
        func=mdp.feet_air_time_positive_biped, weight=1.0, params={**TWIST, "sensor_cfg": MISSING, "threshold": 0.5}
    )
    feet_slide: RewardTermCfg = RewardTermCfg(
        func=mdp.feet_slide, weight=-0.25, params={"sensor_cfg": MISSING, "asset_cfg": MISSING}
    )
    undesired_contacts: RewardTermCfg | None = None  # such contacts end the episode
    is_terminated: RewardTermCfg = RewardTermCfg(func=mdp.is_terminated, weight=-200.0)
    joint_deviation_hip: RewardTermCfg = RewardTermCfg(
        func=mdp.joint_deviation_l1, weight=-0.2, params={"asset_cfg": joints(".*_thigh:[02]")}
    )
    joint_deviation_arms: RewardTermCfg = RewardTermCfg(
        func=mdp.joint_deviation_l1, weight=-0.2, params={"asset_cfg": joints(".*_upper_arm:.", ".*_elbow")}
    )
    joint_deviation_waist: RewardTermCfg = RewardTermCfg(
        func=mdp.joint_deviation_l1, weight=-0.2, params={"asset_cfg": joints("lower_waist:.", "abdomen_x")}
    )


@configclass
class HumanoidRoughRewardsCfg(HumanoidRewardsCfg):
    """Rewards on rough ground, where turning is learnt late: it counts twice, at first with a wide kernel."""

    track_ang_vel_z_exp: RewardTermCfg = RewardTermCfg(
        func=mdp.track_ang_vel_z_world_exp, weight=2.0, params={**TWIST, "std": 1.0}
    )


@configclass
class HumanoidRoughCurriculumCfg(CurriculumCfg):
    """Curriculum on rough ground: harder ground, and yaw rates that must be exact from the 1500th iteration on."""

    yaw_rate: CurriculumTermCfg | None = CurriculumTermCfg(
        func=mdp.modify_term_cfg,
        params={"address": "rewards.track_ang_vel_z_exp.std", "value": 0.5, "start_step": 12000, "num_steps": 36000},
    )


@configclass
class HumanoidCommandsCfg(CommandsCfg):
    """Command: mostly forward, as people walk."""

    def __post_init__(self) -> None:
        ranges = self.base_velocity.ranges
        ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z = (-0.5, 1.0), (-0.3, 0.3), (-1.0, 1.0)


@configclass
class HumanoidActionsCfg(ActionsCfg):
    """Actions: positions of the joints, relative to the default pose, over a larger range."""

    def __post_init__(self) -> None:
        self.joint_pos.scale = 0.5


@configclass
class HumanoidFields:
    """Fields that both tasks of the humanoid share: the roles of its bodies, and the view."""

    base: str = "torso"
    feet: BodyNames = ".*_foot"
    falls_on: BodyNames | None = FALLS_ON
    viewer: ViewerCfg = VelocityEnvCfg().viewer.replace(eye=(2.8, -3.2, 0.5), lookat=(0.0, 0.0, -0.35))


@configclass
class HumanoidFlatEnvCfg(HumanoidFields, VelocityEnvCfg):
    """Humanoid on a plane: 75 observations, 21 joint positions."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    actions: HumanoidActionsCfg = HumanoidActionsCfg()
    commands: HumanoidCommandsCfg = HumanoidCommandsCfg()
    rewards: HumanoidRewardsCfg = HumanoidRewardsCfg()


@configclass
class HumanoidFlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for the humanoid on a plane."""

    experiment_name: str = "velocity_flat_humanoid"
    max_iterations: int = 1000


@configclass
class HumanoidRoughEnvCfg(HumanoidFields, VelocityRoughEnvCfg):
    """Humanoid on rough ground: 262 observations, 187 of them heights."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5, robot=ROBOT_CFG)
    actions: HumanoidActionsCfg = HumanoidActionsCfg()
    commands: HumanoidCommandsCfg = HumanoidCommandsCfg()
    rewards: HumanoidRoughRewardsCfg = HumanoidRoughRewardsCfg()
    curriculum: HumanoidRoughCurriculumCfg = HumanoidRoughCurriculumCfg()


@configclass
class HumanoidRoughPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO for the humanoid on rough ground."""

    experiment_name: str = "velocity_rough_humanoid"
    max_iterations: int = 3000
