# SPDX-License-Identifier: Apache-2.0
"""Velocity tasks of Unitree's G1: ``Stripe-Velocity-Flat-G1-v0`` and ``Stripe-Velocity-Rough-G1-v0``.

Rewards, randomisation, pushes and noise are those of mjlab's velocity tasks of the G1, with these differences. They
are for trainings of 1500 iterations, of which mjlab's task has 30,000:

- Time on one foot is rewarded, as in Isaac Lab's task of the G1: else the robot stands long before it takes a step, and
  a step costs more than it gains.
- Changes of actions cost a tenth at first. At once they would cost more than standing gains, and ending early, or
  hardly moving, would be learnt first.
- On rough ground, where the height of a foot above the ground is not its height above the origin, heights of feet cost
  nothing. Commands there are mostly forward, turn faster, and are those of a heading, as in Isaac Lab's task: a robot
  that follows a random yaw rate walks in circles, and is sent back to easier ground for it.
- On rough ground turning is rewarded by the yaw rate alone, at first with a wide kernel. mjlab's kernel of all three
  rates gives next to nothing to a robot that sways, as it does while it explores, so that it would learn to turn last.
- Angular momentum costs nothing. Contacts of other bodies than the feet cost what collisions of the robot with itself
  do.
"""

from __future__ import annotations

import math

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import CurriculumTermCfg, RewardTermCfg, TerminationTermCfg
from stripe_newton.sim import MuJoCoSolverCfg
from stripe_tasks.published_robots import G1_DRIVES, action_scale, g1_cfg

from .manager_based import (
    BodyNames,
    RoughSceneCfg,
    VelocityEnvCfg,
    VelocityPPORunnerCfg,
    VelocityRoughEnvCfg,
    VelocityRoughPPORunnerCfg,
    VelocitySceneCfg,
)
from .manager_terms import (
    TWIST,
    CurriculumCfg,
    RewardsCfg,
    RoughTerminationsCfg,
    TerminationsCfg,
    bodies,
    contacts,
    joints,
)
from .published_quadrupeds import placed, start_gently, use_mjlab_events

__all__ = [
    "G1FlatEnvCfg",
    "G1FlatPPORunnerCfg",
    "G1RewardsCfg",
    "G1RoughEnvCfg",
    "G1RoughPPORunnerCfg",
    "G1RoughRewardsCfg",
]

TORSO = "torso_link"
FEET = "(left|right)_ankle_roll_link"
OTHERS = "(?!.*_ankle_roll_link).*"
"""All bodies but the feet; two of them touch where the robot collides with itself."""
SOLE = 0.035
"""Height of a foot's frame above the ground that it stands on [m]."""
MOVING = {**TWIST, "command_threshold": 0.05}
STANDING = {".*": 0.05}
WALKING = {
    ".*_hip_pitch_joint": 0.3,
    ".*_hip_(roll|yaw)_joint": 0.15,
    ".*_knee_joint": 0.35,
    ".*_ankle_pitch_joint": 0.25,
    ".*_ankle_roll_joint": 0.1,
    "waist_yaw_joint": 0.2,
    "waist_roll_joint": 0.08,
    "waist_pitch_joint": 0.1,
    ".*_shoulder_(pitch|roll)_joint": 0.15,
    ".*_shoulder_yaw_joint": 0.1,
    ".*_elbow_joint": 0.15,
    ".*_wrist_.*_joint": 0.3,
}
RUNNING = {
    ".*_hip_pitch_joint": 0.5,
    ".*_hip_(roll|yaw)_joint": 0.2,
    ".*_knee_joint": 0.6,
    ".*_ankle_pitch_joint": 0.35,
    ".*_ankle_roll_joint": 0.15,
    "waist_yaw_joint": 0.3,
    "waist_roll_joint": 0.08,
    "waist_pitch_joint": 0.2,
    ".*_shoulder_pitch_joint": 0.5,
    ".*_shoulder_roll_joint": 0.2,
    ".*_shoulder_yaw_joint": 0.15,
    ".*_elbow_joint": 0.35,
    ".*_wrist_.*_joint": 0.3,
}
"""How far joints may be from the default pose, by gait [rad]."""


@configclass
class G1RewardsCfg(RewardsCfg):
    """Rewards of the G1: follow the command upright, near the default pose, with quiet feet."""

    track_lin_vel_xy_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_linear_velocity, weight=2.0, params={**TWIST, "std": 0.5}
    )
    track_ang_vel_z_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_angular_velocity, weight=2.0, params={**TWIST, "std": math.sqrt(0.5)}
    )
    upright: RewardTermCfg = RewardTermCfg(
        func=mdp.upright, weight=1.0, params={"asset_cfg": bodies(TORSO), "std": math.sqrt(0.2)}
    )
    pose: RewardTermCfg = RewardTermCfg(
        func=mdp.variable_posture,
        weight=1.0,
        params={
            **TWIST,
            "asset_cfg": joints(".*"),
            "std_standing": STANDING,
            "std_walking": WALKING,
            "std_running": RUNNING,
            "walking_threshold": 0.05,
            "running_threshold": 1.5,
        },
    )
    body_ang_vel: RewardTermCfg = RewardTermCfg(
        func=mdp.body_angular_velocity_penalty, weight=-0.05, params={"asset_cfg": bodies(TORSO)}
    )
    action_rate_l2: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.01)
    joint_pos_limits: RewardTermCfg = RewardTermCfg(func=mdp.joint_pos_limits, weight=-1.0)
    foot_clearance: RewardTermCfg | None = RewardTermCfg(
        func=mdp.feet_clearance,
        weight=-2.0,
        params={**MOVING, "asset_cfg": bodies(FEET), "target_height": 0.1 + SOLE},
    )
    foot_swing_height: RewardTermCfg | None = RewardTermCfg(
        func=mdp.feet_swing_height,
        weight=-0.25,
        params={**MOVING, "sensor_cfg": contacts(FEET), "asset_cfg": bodies(FEET), "target_height": 0.1 + SOLE},
    )
    foot_slip: RewardTermCfg = RewardTermCfg(
        func=mdp.feet_slip,
        weight=-0.1,
        params={**MOVING, "sensor_cfg": contacts(FEET), "asset_cfg": bodies(FEET)},
    )
    soft_landing: RewardTermCfg = RewardTermCfg(
        func=mdp.soft_landing, weight=-1.0e-5, params={**MOVING, "sensor_cfg": contacts(FEET)}
    )
    feet_air_time: RewardTermCfg | None = RewardTermCfg(
        func=mdp.feet_air_time_positive_biped, weight=2.0, params={**TWIST, "sensor_cfg": MISSING, "threshold": 0.4}
    )
    undesired_contacts: RewardTermCfg | None = RewardTermCfg(
        func=mdp.undesired_contacts, weight=-0.5, params={"sensor_cfg": contacts(OTHERS), "threshold": 10.0}
    )
    lin_vel_z_l2: RewardTermCfg | None = None
    ang_vel_xy_l2: RewardTermCfg | None = None
    joint_torques_l2: RewardTermCfg | None = None
    joint_acc_l2: RewardTermCfg | None = None
    flat_orientation_l2: RewardTermCfg | None = None


SMOOTH_LATER = CurriculumTermCfg(
    func=mdp.modify_term_cfg,
    params={"address": "rewards.action_rate_l2.weight", "value": -0.1, "start_step": 6000, "num_steps": 24000},
)
"""Weight of changes of actions, from its first value to mjlab's between the 250th and the 1000th iteration."""


TURN_BETTER = CurriculumTermCfg(
    func=mdp.modify_term_cfg,
    params={"address": "rewards.track_ang_vel_z_exp.std", "value": 0.5, "start_step": 12000, "num_steps": 36000},
)
"""Width of the kernel for the yaw rate, from its first value to Isaac Lab's between the 500th and the 1500th
iteration."""


@configclass
class G1RoughRewardsCfg(G1RewardsCfg):
    """Rewards on rough ground: velocities about the vertical, joints that may go further from the default pose."""

    track_lin_vel_xy_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_lin_vel_xy_yaw_frame_exp, weight=2.0, params={**TWIST, "std": 0.5}
    )
    track_ang_vel_z_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_ang_vel_z_world_exp, weight=2.0, params={**TWIST, "std": 1.0}
    )
    foot_clearance: RewardTermCfg | None = None
    foot_swing_height: RewardTermCfg | None = None

    def __post_init__(self) -> None:
        self.pose.params["std_walking"] = RUNNING


@configclass
class G1CurriculumCfg:
    """Curriculum: smooth actions count more and more."""

    action_rate: CurriculumTermCfg = SMOOTH_LATER


@configclass
class G1RoughCurriculumCfg(CurriculumCfg):
    """Curriculum on rough ground: harder ground, smooth actions, and exact yaw rates."""

    action_rate: CurriculumTermCfg = SMOOTH_LATER
    yaw_rate: CurriculumTermCfg | None = TURN_BETTER


FELL_OVER = TerminationTermCfg(func=mdp.bad_orientation, params={"limit_angle": math.radians(70.0)})


@configclass
class G1TerminationsCfg(TerminationsCfg):
    """An episode ends when the robot has tipped over, or after its full length."""

    base_contact: TerminationTermCfg | None = None
    fell_over: TerminationTermCfg = FELL_OVER


@configclass
class G1RoughTerminationsCfg(RoughTerminationsCfg):
    """An episode also ends near the edge of the terrain."""

    base_contact: TerminationTermCfg | None = None
    fell_over: TerminationTermCfg = FELL_OVER


def _set_up(cfg: VelocityEnvCfg) -> None:
    """Set what the tasks on both grounds share: actions, commands, events, room for contacts, the view."""
    cfg.actions.joint_pos.scale = action_scale(G1_DRIVES)
    use_mjlab_events(cfg, (0.3, 1.2))
    command = cfg.commands.base_velocity
    command.resampling_time_range = (3.0, 8.0)
    command.rel_standing_envs, command.rel_heading_envs = 0.1, 0.3
    command.ranges.ang_vel_z = (-0.5, 0.5)
    cfg.sim.solver = MuJoCoSolverCfg(iterations=10, ls_iterations=20, njmax=300, nconmax=70, drive_limits=True)
    cfg.viewer.eye, cfg.viewer.lookat = (2.2, -2.4, 0.5), (0.0, 0.0, -0.05)


@configclass
class G1FlatEnvCfg(VelocityEnvCfg):
    """G1 on a plane: 99 observations, 29 joint positions."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5)
    rewards: G1RewardsCfg = G1RewardsCfg()
    terminations: G1TerminationsCfg = G1TerminationsCfg()
    curriculum: G1CurriculumCfg = G1CurriculumCfg()
    base: str = TORSO
    feet: BodyNames = FEET

    def __post_init__(self) -> None:
        self.scene.robot = placed(g1_cfg())
        super().__post_init__()
        _set_up(self)


@configclass
class G1RoughEnvCfg(VelocityRoughEnvCfg):
    """G1 on rough ground: 286 observations, 187 of them heights."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5)
    rewards: G1RoughRewardsCfg = G1RoughRewardsCfg()
    terminations: G1RoughTerminationsCfg = G1RoughTerminationsCfg()
    curriculum: G1RoughCurriculumCfg = G1RoughCurriculumCfg()
    base: str = TORSO
    feet: BodyNames = FEET

    def __post_init__(self) -> None:
        self.scene.robot = placed(g1_cfg())
        super().__post_init__()
        _set_up(self)
        command = self.commands.base_velocity
        command.resampling_time_range, command.rel_heading_envs = (10.0, 10.0), 1.0
        ranges = command.ranges
        ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z = (-0.5, 1.0), (-0.3, 0.3), (-1.0, 1.0)


@configclass
class G1FlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for the G1 on a plane."""

    experiment_name: str = "velocity_flat_g1"
    max_iterations: int = 1500

    def __post_init__(self) -> None:
        start_gently(self, 0.01)


@configclass
class G1RoughPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO for the G1 on rough ground."""

    experiment_name: str = "velocity_rough_g1"
    max_iterations: int = 3000

    def __post_init__(self) -> None:
        # With 0.01 the spread was still 0.5 after 2000 iterations: it cost as much as following the command gained.
        start_gently(self, 0.005)
