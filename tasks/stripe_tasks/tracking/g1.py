# SPDX-License-Identifier: Apache-2.0
"""Motion tracking by Unitree's G1: ``Stripe-Tracking-Flat-G1-v0``, and ``-Play-v0`` for what it has learnt.

Terms, weights, noise and randomisation are those of BeyondMimic (Liao et al. 2025) as mjlab has them, with these
differences: the bins before a failure are sampled more often, too, half of the episodes begin anywhere, and there is a
reward for the places of hands and feet alone. Motions are not part of this package: ``commands.motion.motion_file``
names files, such as those of LAFAN1 that Unitree publishes, retargeted to this robot.
"""

from __future__ import annotations

from typing import Any

from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.noise import UniformNoiseCfg
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sensors import ContactSensorCfg
from stripe_newton.sim import MuJoCoSolverCfg, RigidBodyMaterialCfg, SimulationCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.published_robots import G1_DRIVES, action_scale, g1_cfg
from stripe_tasks.robot_scene import RobotSceneCfg

__all__ = ["TrackingEnvCfg", "TrackingPPORunnerCfg", "TrackingPlayEnvCfg"]

ANCHOR = "torso_link"
TRACKED = [
    "pelvis",
    "(left|right)_hip_roll_link",
    "(left|right)_knee_link",
    "(left|right)_ankle_roll_link",
    ANCHOR,
    "(left|right)_shoulder_roll_link",
    "(left|right)_elbow_link",
    "(left|right)_wrist_yaw_link",
]
"""Bodies whose poses and velocities are compared with the motion's."""
ENDS = ["(left|right)_ankle_roll_link", "(left|right)_wrist_yaw_link"]
"""Bodies that end an episode where they are far from the motion's."""
MOTION = {"command_name": "motion"}
BODIES = {**MOTION, "asset_cfg": SceneEntityCfg("robot", body_names=TRACKED)}
HANDS_AND_FEET = {**MOTION, "asset_cfg": SceneEntityCfg("robot", body_names=ENDS)}
VELOCITIES = {
    "x": (-0.5, 0.5),
    "y": (-0.5, 0.5),
    "z": (-0.2, 0.2),
    "roll": (-0.52, 0.52),
    "pitch": (-0.52, 0.52),
    "yaw": (-0.78, 0.78),
}
"""Changes of the root's velocity by pushes and at the start of an episode [m/s, rad/s]."""
SOLES = SceneEntityCfg("robot", body_names="(left|right)_ankle_roll_link")


def noise(bound: float) -> UniformNoiseCfg:
    """Uniform noise between ``-bound`` and ``bound``."""
    return UniformNoiseCfg(n_min=-bound, n_max=bound)


def follow(func: Any, weight: float, std: float, params: dict[str, Any]) -> RewardTermCfg:
    """Reward for following the motion."""
    return RewardTermCfg(func=func, weight=weight, params={**params, "std": std})


@configclass
class TrackingSceneCfg(RobotSceneCfg):
    """The robot on a plane, with a sensor of the contacts of all its bodies."""

    contact_forces: ContactSensorCfg = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*")


@configclass
class CommandsCfg:
    """Command: the next frame of the motions."""

    motion: mdp.MotionCommandCfg = mdp.MotionCommandCfg(
        asset_name="robot",
        anchor_body_name=ANCHOR,
        body_names=TRACKED,
        pose_range={
            "x": (-0.05, 0.05),
            "y": (-0.05, 0.05),
            "z": (-0.01, 0.01),
            "roll": (-0.1, 0.1),
            "pitch": (-0.1, 0.1),
            "yaw": (-0.2, 0.2),
        },
        velocity_range=VELOCITIES,
        joint_position_range=(-0.1, 0.1),
        # Episodes begin up to three seconds before a hard part, so that the robot comes to it as it does in a whole
        # motion. In the part itself the noise of the start decides more than what the policy does.
        adaptive_kernel_size=3,
        # About as many failures as 4096 robots have in a step. With a tenth of it nine of ten episodes begin at the
        # hardest parts, and what was learnt of the others is lost.
        adaptive_uniform_ratio=1.0,
    )


@configclass
class ActionsCfg:
    """Actions: positions of the joints, relative to the default pose; encoders err."""

    joint_pos: mdp.JointPositionActionCfg = mdp.JointPositionActionCfg(
        asset_name="robot",
        joint_names=[".*"],
        scale=action_scale(G1_DRIVES),
        use_default_offset=True,
        apply=mdp.apply_joint_position_biased,
    )


@configclass
class PolicyCfg(ObservationGroupCfg):
    """The next frame of the motion and the robot's own state, with the noise of its sensors."""

    command: ObservationTermCfg = ObservationTermCfg(func=mdp.generated_commands, params=MOTION)
    motion_anchor_pos_b: ObservationTermCfg = ObservationTermCfg(
        func=mdp.motion_anchor_pos_b, params=MOTION, noise=noise(0.25)
    )
    motion_anchor_ori_b: ObservationTermCfg = ObservationTermCfg(
        func=mdp.motion_anchor_ori_b, params=MOTION, noise=noise(0.05)
    )
    base_lin_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_lin_vel, noise=noise(0.5))
    base_ang_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_ang_vel, noise=noise(0.2))
    joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel_biased, noise=noise(0.01))
    joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel, noise=noise(0.5))
    actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)
    enable_corruption: bool = True


@configclass
class CriticCfg(ObservationGroupCfg):
    """The same without noise and errors, and the poses of the robot's bodies."""

    command: ObservationTermCfg = ObservationTermCfg(func=mdp.generated_commands, params=MOTION)
    motion_anchor_pos_b: ObservationTermCfg = ObservationTermCfg(func=mdp.motion_anchor_pos_b, params=MOTION)
    motion_anchor_ori_b: ObservationTermCfg = ObservationTermCfg(func=mdp.motion_anchor_ori_b, params=MOTION)
    body_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.robot_body_pos_b, params=BODIES)
    body_ori: ObservationTermCfg = ObservationTermCfg(func=mdp.robot_body_ori_b, params=BODIES)
    base_lin_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_lin_vel)
    base_ang_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_ang_vel)
    joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel)
    joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel)
    actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)


@configclass
class ObservationsCfg:
    """Observations: with noise for the policy, without noise for the critic."""

    policy: PolicyCfg = PolicyCfg()
    critic: CriticCfg = CriticCfg()


@configclass
class RewardsCfg:
    """Rewards for following the motion, less costs of jerky actions and of joints at their limits."""

    motion_global_root_pos: RewardTermCfg = follow(mdp.motion_global_anchor_position_error_exp, 0.5, 0.3, MOTION)
    motion_global_root_ori: RewardTermCfg = follow(mdp.motion_global_anchor_orientation_error_exp, 0.5, 0.4, MOTION)
    motion_body_pos: RewardTermCfg = follow(mdp.motion_relative_body_position_error_exp, 1.0, 0.3, BODIES)
    # A foot that is 0.2 m too low ends the episode, but is worth next to nothing in the mean over all bodies.
    motion_ends_pos: RewardTermCfg | None = follow(
        mdp.motion_relative_body_position_error_exp, 1.0, 0.15, HANDS_AND_FEET
    )
    motion_body_ori: RewardTermCfg = follow(mdp.motion_relative_body_orientation_error_exp, 1.0, 0.4, BODIES)
    motion_body_lin_vel: RewardTermCfg = follow(mdp.motion_global_body_linear_velocity_error_exp, 1.0, 1.0, BODIES)
    motion_body_ang_vel: RewardTermCfg = follow(mdp.motion_global_body_angular_velocity_error_exp, 1.0, 3.14, BODIES)
    action_rate_l2: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.1)
    joint_limit: RewardTermCfg = RewardTermCfg(func=mdp.joint_pos_limits, weight=-10.0)
    undesired_contacts: RewardTermCfg = RewardTermCfg(
        func=mdp.undesired_contacts,
        weight=-0.1,
        params={
            # The soles and the hands may touch something.
            "sensor_cfg": SceneEntityCfg("contact_forces", body_names="(?!.*(ankle_roll|wrist_yaw)_link).*"),
            "threshold": 1.0,
        },
    )


@configclass
class TerminationsCfg:
    """An episode ends where the robot is far from the motion, and with the motion."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)
    motion_finished: TerminationTermCfg = TerminationTermCfg(func=mdp.motion_finished, params=MOTION, time_out=True)
    anchor_pos: TerminationTermCfg = TerminationTermCfg(
        func=mdp.bad_anchor_pos_z_only, params={**MOTION, "threshold": 0.25}
    )
    anchor_ori: TerminationTermCfg = TerminationTermCfg(func=mdp.bad_anchor_ori, params={**MOTION, "threshold": 0.8})
    ee_body_pos: TerminationTermCfg = TerminationTermCfg(
        func=mdp.bad_motion_body_pos_z_only,
        params={**MOTION, "asset_cfg": SceneEntityCfg("robot", body_names=ENDS), "threshold": 0.25},
    )


@configclass
class EventsCfg:
    """Events: robots differ, and are pushed."""

    push_robot: EventTermCfg | None = EventTermCfg(
        func=mdp.push_by_setting_velocity,
        mode="interval",
        interval_range_s=(1.0, 3.0),
        params={"velocity_range": VELOCITIES},
    )
    base_com: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_com,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", body_names=ANCHOR),
            "com_range": {"x": (-0.025, 0.025), "y": (-0.05, 0.05), "z": (-0.05, 0.05)},
        },
    )
    encoder_bias: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_encoder_bias, mode="startup", params={"bias_range": (-0.01, 0.01)}
    )
    foot_friction: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_material,
        mode="startup",
        params={"asset_cfg": SOLES, "static_friction_range": (0.3, 1.2)},
    )


@configclass
class TrackingEnvCfg(ManagerBasedRLEnvCfg):
    """G1 that tracks motions at 50 Hz, four physics steps each, in episodes of 10 s."""

    decimation: int = 4
    episode_length_s: float = 10.0
    scene: TrackingSceneCfg = TrackingSceneCfg(num_envs=4096, env_spacing=2.5)
    sim: SimulationCfg = SimulationCfg(
        dt=0.005,
        solver=MuJoCoSolverCfg(iterations=10, ls_iterations=20, njmax=250, nconmax=60, drive_limits=True),
        # MuJoCo takes the larger friction of two shapes: little on the ground lets the randomised soles decide.
        physics_material=RigidBodyMaterialCfg(static_friction=0.3, dynamic_friction=0.3),
    )
    viewer: ViewerCfg = ViewerCfg(
        origin_type="asset_root",
        asset_name="Robot",
        eye=(2.2, -2.4, 0.5),
        lookat=(0.0, 0.0, -0.05),
        num_shown=4,
    )
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    commands: CommandsCfg = CommandsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()

    def __post_init__(self) -> None:
        self.scene.robot = g1_cfg().replace(prim_path="{ENV_REGEX_NS}/Robot")


@configclass
class TrackingPlayEnvCfg(TrackingEnvCfg):
    """The same for a trained policy: motions from their start to their end, without pushes and noise of sensors."""

    episode_length_s: float = 1.0e5

    def __post_init__(self) -> None:
        super().__post_init__()
        self.events.push_robot = None
        self.observations.policy.enable_corruption = False
        self.commands.motion.sampling_mode = "start"
        self.commands.motion.pose_range = {}
        self.commands.motion.velocity_range = {}
        self.commands.motion.joint_position_range = (0.0, 0.0)


@configclass
class TrackingPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for motion tracking."""

    experiment_name: str = "tracking_flat_g1"
    num_steps_per_env: int = 24
    max_iterations: int = 10000
    save_interval: int = 500
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(512, 256, 128),
        obs_normalization=True,
        # With mjlab's spread of 1 the first actions cost more than following gains, and ending early is learnt first.
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.5),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(512, 256, 128), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.005, learning_rate=1.0e-3)
