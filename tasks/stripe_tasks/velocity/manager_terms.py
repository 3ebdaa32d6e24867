# SPDX-License-Identifier: Apache-2.0
"""Manager terms of the velocity tasks: command, actions, observations, rewards, terminations, events and curriculum.

Terms have the names that Isaac Lab and mjlab give them. Bodies that a robot's config must name are ``MISSING``.
"""

from __future__ import annotations

import math

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import (
    CurriculumTermCfg,
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.noise import UniformNoiseCfg

__all__ = [
    "TWIST",
    "ActionsCfg",
    "CommandsCfg",
    "CurriculumCfg",
    "EventsCfg",
    "ObservationsCfg",
    "ProprioceptionCfg",
    "RewardsCfg",
    "RoughEventsCfg",
    "RoughObservationsCfg",
    "RoughTerminationsCfg",
    "ScanningCfg",
    "TerminationsCfg",
    "bodies",
    "contacts",
    "joints",
    "noise",
]

TWIST = {"command_name": "base_velocity"}
"""Parameters of terms that read the command."""


def contacts(*bodies: str) -> SceneEntityCfg:
    """Bodies of the contact sensor, by expression."""
    return SceneEntityCfg("contact_forces", body_names=list(bodies))


def bodies(*names: str) -> SceneEntityCfg:
    """Bodies of the robot, by expression."""
    return SceneEntityCfg("robot", body_names=list(names))


def joints(*names: str) -> SceneEntityCfg:
    """Joints of the robot, by expression."""
    return SceneEntityCfg("robot", joint_names=list(names))


def noise(bound: float) -> UniformNoiseCfg:
    """Uniform noise between ``-bound`` and ``bound``."""
    return UniformNoiseCfg(n_min=-bound, n_max=bound)


@configclass
class CommandsCfg:
    """Command: velocity of the base, with a heading to turn to."""

    base_velocity: mdp.UniformVelocityCommandCfg = mdp.UniformVelocityCommandCfg(
        asset_name="robot",
        resampling_time_range=(10.0, 10.0),
        rel_standing_envs=0.05,
        rel_heading_envs=1.0,
        heading_command=True,
        heading_control_stiffness=0.5,
        ranges=mdp.UniformVelocityCommandCfg.Ranges(
            lin_vel_x=(-1.0, 1.0), lin_vel_y=(-1.0, 1.0), ang_vel_z=(-1.0, 1.0), heading=(-math.pi, math.pi)
        ),
    )


@configclass
class ActionsCfg:
    """Actions: positions of the joints, relative to the default pose."""

    joint_pos: mdp.JointPositionActionCfg = mdp.JointPositionActionCfg(
        asset_name="robot", joint_names=[".*"], scale=0.25, use_default_offset=True
    )


@configclass
class ProprioceptionCfg(ObservationGroupCfg):
    """Proprioception: the robot's own state and command, with the noise of its sensors."""

    base_lin_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_lin_vel, noise=noise(0.1))
    base_ang_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_ang_vel, noise=noise(0.2))
    projected_gravity: ObservationTermCfg = ObservationTermCfg(func=mdp.projected_gravity, noise=noise(0.05))
    velocity_commands: ObservationTermCfg | None = ObservationTermCfg(func=mdp.generated_commands, params=TWIST)
    joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel, noise=noise(0.01))
    joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel, noise=noise(1.5))
    actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)
    enable_corruption: bool = True


@configclass
class ObservationsCfg:
    """Observations: with noise for the policy, without noise for the critic."""

    policy: ProprioceptionCfg = ProprioceptionCfg()
    critic: ProprioceptionCfg = ProprioceptionCfg(enable_corruption=False)


@configclass
class ScanningCfg(ProprioceptionCfg):
    """Proprioception and a scan of the ground around the robot."""

    height_scan: ObservationTermCfg = ObservationTermCfg(
        func=mdp.height_scan,
        params={"sensor_cfg": SceneEntityCfg("height_scanner")},
        noise=noise(0.1),
        clip=(-1.0, 1.0),
    )


@configclass
class RoughObservationsCfg(ObservationsCfg):
    """Observations with a height scan: with noise for the policy, without noise for the critic."""

    policy: ScanningCfg = ScanningCfg()
    critic: ScanningCfg = ScanningCfg(enable_corruption=False)


@configclass
class RewardsCfg:
    """Rewards for following the command, less costs of unsteady motion."""

    track_lin_vel_xy_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_lin_vel_xy_exp, weight=1.5, params={**TWIST, "std": 0.5}
    )
    track_ang_vel_z_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_ang_vel_z_exp, weight=0.75, params={**TWIST, "std": 0.5}
    )
    lin_vel_z_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.lin_vel_z_l2, weight=-2.0)
    ang_vel_xy_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.ang_vel_xy_l2, weight=-0.05)
    joint_torques_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.joint_torques_l2, weight=-2.0e-4)
    joint_acc_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.joint_acc_l2, weight=-2.5e-7)
    action_rate_l2: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.01)
    flat_orientation_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.flat_orientation_l2, weight=-2.5)
    joint_pos_limits: RewardTermCfg = RewardTermCfg(func=mdp.joint_pos_limits, weight=-1.0)
    feet_air_time: RewardTermCfg | None = RewardTermCfg(
        func=mdp.feet_air_time, weight=0.25, params={**TWIST, "sensor_cfg": MISSING, "threshold": 0.5}
    )
    undesired_contacts: RewardTermCfg | None = RewardTermCfg(
        func=mdp.undesired_contacts, weight=-1.0, params={"sensor_cfg": MISSING, "threshold": 1.0}
    )


@configclass
class TerminationsCfg:
    """An episode ends when the robot has fallen, or after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)
    base_contact: TerminationTermCfg | None = TerminationTermCfg(
        func=mdp.illegal_contact, params={"sensor_cfg": MISSING, "threshold": 1.0}
    )
    left_scenery: TerminationTermCfg | None = None
    """In an imported scenery: outside of it, or fallen below it."""


@configclass
class EventsCfg:
    """Events: masses and friction differ between robots, episodes start near the origin in any direction, pushes."""

    payload: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_mass,
        mode="startup",
        params={"asset_cfg": MISSING, "mass_distribution_params": (-1.0, 2.0), "operation": "add"},
    )
    centre_of_mass: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_com,
        mode="startup",
        params={"asset_cfg": MISSING, "com_range": {"x": (-0.02, 0.02), "y": (-0.02, 0.02), "z": (-0.02, 0.02)}},
    )
    soles: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_material,
        mode="startup",
        params={"asset_cfg": MISSING, "static_friction_range": (0.5, 1.2)},
    )
    reset_base: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_uniform,
        mode="reset",
        params={
            "pose_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "yaw": (-math.pi, math.pi)},
            "velocity_range": {},
        },
    )
    reset_robot_joints: EventTermCfg = EventTermCfg(
        func=mdp.reset_joints_by_scale,
        mode="reset",
        params={"position_range": (0.9, 1.1), "velocity_range": (0.0, 0.0)},
    )
    push_robot: EventTermCfg | None = EventTermCfg(
        func=mdp.push_by_setting_velocity,
        mode="interval",
        interval_range_s=(10.0, 15.0),
        params={"velocity_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5)}},
    )
    encoder_bias: EventTermCfg | None = None
    """Errors of the encoders, where the task has them."""


@configclass
class RoughTerminationsCfg(TerminationsCfg):
    """An episode also ends near the edge of the terrain."""

    out_of_bounds: TerminationTermCfg = TerminationTermCfg(
        func=mdp.terrain_out_of_bounds, params={"distance_buffer": 3.0}, time_out=True
    )


@configclass
class RoughEventsCfg(EventsCfg):
    """Events on rough ground: episodes start on the surface of the terrain."""

    reset_base: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_uniform_on_terrain,
        mode="reset",
        params={
            "pose_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "yaw": (-math.pi, math.pi)},
            "velocity_range": {},
            "footprint": 0.3,
        },
    )


@configclass
class CurriculumCfg:
    """Curriculum: robots that get far go on to harder ground."""

    terrain_levels: CurriculumTermCfg = CurriculumTermCfg(func=mdp.terrain_levels_vel, params=TWIST)
