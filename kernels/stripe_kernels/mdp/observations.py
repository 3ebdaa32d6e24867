# SPDX-License-Identifier: Apache-2.0
"""Observations: ``term(env, ..., out)`` writes the numbers of one environment into its slice ``out``.

The decorator ``@writes`` declares how many numbers those are.
"""

from typing import TYPE_CHECKING

import warp as wp

from ..data import ActionData, ArticulationData, CommandData, EpisodeData
from ..removed_tables import forward_tables
from ..term_info import Each, writes
from . import frames

__all__ = [
    "base_ang_vel",
    "base_lin_vel",
    "base_pos_z",
    "body_incoming_wrench",
    "body_pose_w",
    "body_projected_gravity_b",
    "current_time_s",
    "generated_commands",
    "joint_effort",
    "joint_pos",
    "joint_pos_limit_normalized",
    "joint_pos_rel",
    "joint_vel",
    "joint_vel_rel",
    "last_action",
    "projected_gravity",
    "remaining_time_s",
    "root_ang_vel_w",
    "root_lin_vel_w",
    "root_pos_w",
    "root_quat_w",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, sizes={"OBSERVATION_SIZES": __name__})


@wp.func
def _write_vec3(v: wp.vec3, first: int, out: wp.array[float]):
    """Write three numbers from index ``first`` on."""
    for k in range(3):
        out[first + k] = v[k]


@writes(1)
@wp.func
def base_pos_z(env: int, robot: ArticulationData, out: wp.array[float]):
    """Height of the root link in the world.

    Formula: ``p.z`` [m].

    Source: Isaac Lab, ``mdp.base_pos_z``.
    """
    out[0] = wp.transform_get_translation(robot.root_pose[env])[2]


@writes(3)
@wp.func
def base_lin_vel(env: int, robot: ArticulationData, out: wp.array[float]):
    """Linear velocity of the root's centre of mass in the root's frame.

    Formula: ``R^T v`` [m/s].

    Source: Isaac Lab, ``mdp.base_lin_vel``.
    """
    _write_vec3(frames.root_lin_vel_b(env, robot), 0, out)


@writes(3)
@wp.func
def base_ang_vel(env: int, robot: ArticulationData, out: wp.array[float]):
    """Angular velocity of the root in the root's frame.

    Formula: ``R^T w`` [rad/s].

    Source: Isaac Lab, ``mdp.base_ang_vel``.
    """
    _write_vec3(frames.root_ang_vel_b(env, robot), 0, out)


@writes(3)
@wp.func
def projected_gravity(env: int, robot: ArticulationData, out: wp.array[float]):
    """Direction of gravity in the root's frame; (0, 0, -1) when upright.

    Formula: ``R^T g / |g|``.

    Source: Isaac Lab, ``mdp.projected_gravity``.
    """
    _write_vec3(frames.projected_gravity_b(env, robot), 0, out)


@writes(3)
@wp.func
def root_pos_w(env: int, robot: ArticulationData, out: wp.array[float]):
    """Position of the root link relative to the environment's origin, in the world's axes.

    Formula: ``p - origin`` [m].

    Source: Isaac Lab, ``mdp.root_pos_w``.
    """
    _write_vec3(wp.transform_get_translation(robot.root_pose[env]) - robot.env_origin[env], 0, out)


@writes(4)
@wp.func
def root_quat_w(env: int, robot: ArticulationData, make_quat_unique: bool, out: wp.array[float]):
    """Orientation of the root link in the world, quaternion (x, y, z, w).

    Formula: ``q``; with ``make_quat_unique`` that of ``q`` and ``-q`` with ``w >= 0``.

    Source: Isaac Lab, ``mdp.root_quat_w``, there (w, x, y, z) before version 3.
    """
    q = wp.transform_get_rotation(robot.root_pose[env])
    if make_quat_unique:
        q = frames.quat_unique(q)
    for k in range(4):
        out[k] = q[k]


@writes(3)
@wp.func
def root_lin_vel_w(env: int, robot: ArticulationData, out: wp.array[float]):
    """Linear velocity of the root's centre of mass in the world.

    Formula: ``v`` [m/s].

    Source: Isaac Lab, ``mdp.root_lin_vel_w``.
    """
    _write_vec3(wp.spatial_top(robot.root_vel[env]), 0, out)


@writes(3)
@wp.func
def root_ang_vel_w(env: int, robot: ArticulationData, out: wp.array[float]):
    """Angular velocity of the root in the world.

    Formula: ``w`` [rad/s].

    Source: Isaac Lab, ``mdp.root_ang_vel_w``.
    """
    _write_vec3(wp.spatial_bottom(robot.root_vel[env]), 0, out)


@writes(Each("body_ids", 7))
@wp.func
def body_pose_w(env: int, robot: ArticulationData, body_ids: wp.array[int], out: wp.array[float]):
    """Poses of link frames relative to the environment's origin, in the world's axes.

    Formula: ``(p_i - origin, q_i)`` [m], quaternion (x, y, z, w), seven numbers a body.

    Source: Isaac Lab, ``mdp.body_pose_w``.
    """
    for i in range(body_ids.shape[0]):
        pose = robot.body_pose[env, body_ids[i]]
        q = wp.transform_get_rotation(pose)
        _write_vec3(wp.transform_get_translation(pose) - robot.env_origin[env], 7 * i, out)
        for k in range(4):
            out[7 * i + 3 + k] = q[k]


@writes(Each("body_ids", 3))
@wp.func
def body_projected_gravity_b(env: int, robot: ArticulationData, body_ids: wp.array[int], out: wp.array[float]):
    """Direction of gravity in the frames of links, unit length.

    Formula: ``R_i^T g / |g|``, three numbers a body.

    Source: Isaac Lab, ``mdp.body_projected_gravity_b``.
    """
    for i in range(body_ids.shape[0]):
        q = wp.transform_get_rotation(robot.body_pose[env, body_ids[i]])
        _write_vec3(wp.quat_rotate_inv(q, robot.gravity_dir), 3 * i, out)


@writes(Each("body_ids", 6))
@wp.func
def body_incoming_wrench(env: int, robot: ArticulationData, body_ids: wp.array[int], out: wp.array[float]):
    """Force and torque on bodies from their parent joints, about their centres of mass, in the world.

    Formula: ``(f_i, t_i)`` [N, N m], six numbers a body.

    Source: Isaac Lab, ``mdp.body_incoming_wrench``.
    """
    for i in range(body_ids.shape[0]):
        wrench = robot.body_parent_wrench[env, body_ids[i]]
        for k in range(6):
            out[6 * i + k] = wrench[k]


@writes(Each("joint_ids"))
@wp.func
def joint_pos(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]):
    """Joint positions.

    Formula: ``q_i`` [m or rad].

    Source: Isaac Lab, ``mdp.joint_pos``.
    """
    for i in range(joint_ids.shape[0]):
        out[i] = robot.joint_pos[env, joint_ids[i]]


@writes(Each("joint_ids"))
@wp.func
def joint_pos_rel(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]):
    """Joint positions relative to the default positions.

    Formula: ``q_i - q_default,i`` [m or rad].

    Source: Isaac Lab, ``mdp.joint_pos_rel``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        out[i] = robot.joint_pos[env, joint] - robot.default_joint_pos[env, joint]


@writes(Each("joint_ids"))
@wp.func
def joint_pos_limit_normalized(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]):
    """Joint positions normalised to -1 and 1 at the soft limits.

    Formula: ``(2 q_i - upper - lower) / (upper - lower)``, 0 where the limits coincide.

    Source: Isaac Lab, ``mdp.joint_pos_limit_normalized``.
    """
    for i in range(joint_ids.shape[0]):
        limits = frames.soft_joint_pos_limits(env, robot, joint_ids[i])
        width = limits[1] - limits[0]
        value = wp.float32(0.0)
        if width > 0.0:
            value = 2.0 * (robot.joint_pos[env, joint_ids[i]] - 0.5 * (limits[0] + limits[1])) / width
        out[i] = value


@writes(Each("joint_ids"))
@wp.func
def joint_vel(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]):
    """Joint velocities.

    Formula: ``qd_i`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.joint_vel``.
    """
    for i in range(joint_ids.shape[0]):
        out[i] = robot.joint_vel[env, joint_ids[i]]


@writes(Each("joint_ids"))
@wp.func
def joint_vel_rel(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]):
    """Joint velocities relative to the default velocities.

    Formula: ``qd_i - qd_default,i`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.joint_vel_rel``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        out[i] = robot.joint_vel[env, joint] - robot.default_joint_vel[env, joint]


@writes(Each("joint_ids"))
@wp.func
def joint_effort(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]):
    """Joint efforts of drives and actuators in the last physics step.

    Formula: ``tau_i = tau_drive,i + tau_other,i`` [N or N m].

    Source: Isaac Lab, ``mdp.joint_effort``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        out[i] = robot.joint_drive_effort[env, joint] + robot.joint_other_effort[env, joint]


@writes(Each("num_actions"))
@wp.func
def last_action(env: int, actions: ActionData, out: wp.array[float]):
    """Action of the policy in this step, before scale and offset.

    Formula: ``a_i``.

    Source: Isaac Lab, ``mdp.last_action``.
    """
    for i in range(actions.action.shape[1]):
        out[i] = actions.action[env, i]


@writes(Each("num_command"))
@wp.func
def generated_commands(env: int, command: CommandData, out: wp.array[float]):
    """Command of a command term, as the policy sees it.

    Formula: ``c_i``, in the units of the command.

    Source: Isaac Lab, ``mdp.generated_commands``.
    """
    for i in range(command.command.shape[1]):
        out[i] = command.command[env, i]


@writes(1)
@wp.func
def current_time_s(env: int, episode: EpisodeData, out: wp.array[float]):
    """Time since the start of the episode.

    Formula: ``n dt`` [s], ``n`` the steps taken.

    Source: Isaac Lab, ``mdp.current_time_s``.
    """
    out[0] = float(episode.length[env]) * episode.step_dt


@writes(1)
@wp.func
def remaining_time_s(env: int, episode: EpisodeData, out: wp.array[float]):
    """Time until the time-out of the episode.

    Formula: ``T - n dt`` [s], ``n`` the steps taken and ``T`` the length of an episode.

    Source: Isaac Lab, ``mdp.remaining_time_s``.
    """
    out[0] = episode.max_length_s - float(episode.length[env]) * episode.step_dt
