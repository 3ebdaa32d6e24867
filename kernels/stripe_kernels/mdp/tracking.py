# SPDX-License-Identifier: Apache-2.0
"""Tracking rewards: terms for following a command, ``term(env, ...) -> float`` before weight and time step."""

import warp as wp

from ..data import ArticulationData, PoseCommandData, VelocityCommandData
from . import frames
from .rewards import joint_deviation_l1

__all__ = [
    "orientation_command_error",
    "position_command_error",
    "position_command_error_tanh",
    "stand_still",
    "track_ang_vel_z_exp",
    "track_ang_vel_z_world_exp",
    "track_lin_vel_xy_exp",
    "track_lin_vel_xy_yaw_frame_exp",
]


# -- velocity to follow


@wp.func
def _exp_of_error_xy(command: VelocityCommandData, env: int, vel: wp.vec3, std: float) -> float:
    """Exponential kernel ``exp(-error^2 / std^2)`` of the horizontal velocity's error."""
    x = command.command[env, 0] - vel[0]
    y = command.command[env, 1] - vel[1]
    return wp.exp(-(x * x + y * y) / (std * std))


@wp.func
def _exp_of_error_yaw(command: VelocityCommandData, env: int, rate: float, std: float) -> float:
    """Exponential kernel ``exp(-error^2 / std^2)`` of the yaw rate's error."""
    error = command.command[env, 2] - rate
    return wp.exp(-error * error / (std * std))


@wp.func
def track_lin_vel_xy_exp(env: int, robot: ArticulationData, command: VelocityCommandData, std: float) -> float:
    """Tracking of the horizontal velocity command in the root's frame, exponential kernel, from 0 to 1.

    Formula: ``exp(-((c.x - v_b.x)^2 + (c.y - v_b.y)^2) / std^2)``, ``std`` [m/s].

    Source: Isaac Lab, ``mdp.track_lin_vel_xy_exp``.
    """
    return _exp_of_error_xy(command, env, frames.root_lin_vel_b(env, robot), std)


@wp.func
def track_ang_vel_z_exp(env: int, robot: ArticulationData, command: VelocityCommandData, std: float) -> float:
    """Tracking of the yaw rate command about the root's own z axis, exponential kernel, from 0 to 1.

    Formula: ``exp(-(c.yaw - w_b.z)^2 / std^2)``, ``std`` [rad/s].

    Source: Isaac Lab, ``mdp.track_ang_vel_z_exp``.
    """
    return _exp_of_error_yaw(command, env, frames.root_ang_vel_b(env, robot)[2], std)


@wp.func
def track_lin_vel_xy_yaw_frame_exp(
    env: int, robot: ArticulationData, command: VelocityCommandData, std: float
) -> float:
    """Tracking of the horizontal velocity command in the root's yaw frame, exponential kernel, from 0 to 1.

    Formula: ``exp(-((c.x - v_y.x)^2 + (c.y - v_y.y)^2) / std^2)``, ``v_y = Rz(yaw)^T v``, ``std`` [m/s].

    Source: Isaac Lab, locomotion ``mdp.track_lin_vel_xy_yaw_frame_exp``.
    """
    q = wp.transform_get_rotation(robot.root_pose[env])
    vel = frames.rotate_inverse_yaw(q, wp.spatial_top(robot.root_vel[env]))
    return _exp_of_error_xy(command, env, vel, std)


@wp.func
def track_ang_vel_z_world_exp(env: int, robot: ArticulationData, command: VelocityCommandData, std: float) -> float:
    """Tracking of the yaw rate command about the vertical, exponential kernel, from 0 to 1.

    Formula: ``exp(-(c.yaw - w.z)^2 / std^2)``, ``std`` [rad/s].

    Source: Isaac Lab, locomotion ``mdp.track_ang_vel_z_world_exp``.
    """
    return _exp_of_error_yaw(command, env, wp.spatial_bottom(robot.root_vel[env])[2], std)


@wp.func
def stand_still(
    env: int,
    robot: ArticulationData,
    command: VelocityCommandData,
    joint_ids: wp.array[int],
    command_threshold: float,
) -> float:
    """Deviation of the joints from their default positions while the command is to stand (a penalty).

    Formula: ``sum_i |q_i - q_default,i|`` [m or rad] where ``|(c.x, c.y)| < command_threshold``, else ``0``.

    Source: Isaac Lab, locomotion ``mdp.stand_still_joint_deviation_l1``, there with 0.06 m/s.
    """
    speed = wp.length(wp.vec2(command.command[env, 0], command.command[env, 1]))
    if speed < command_threshold:
        return joint_deviation_l1(env, robot, joint_ids)
    return 0.0


# -- pose to reach


@wp.func
def position_command_error(
    env: int, robot: ArticulationData, command: PoseCommandData, body_ids: wp.array[int]
) -> float:
    """Distance of a link, the first of ``body_ids``, from the commanded position (a penalty).

    Formula: ``|p_body - (p_root + R_root c)|`` [m].

    Source: Isaac Lab, ``mdp.position_command_error``.
    """
    desired = wp.transform_point(robot.root_pose[env], wp.transform_get_translation(command.pose[env]))
    return wp.length(wp.transform_get_translation(robot.body_pose[env, body_ids[0]]) - desired)


@wp.func
def position_command_error_tanh(
    env: int, robot: ArticulationData, command: PoseCommandData, body_ids: wp.array[int], std: float
) -> float:
    """Closeness of a link, the first of ``body_ids``, to the commanded position, from 0 to 1.

    Formula: ``1 - tanh(d / std)``, ``d`` as in ``position_command_error``, ``std`` [m].

    Source: Isaac Lab, ``mdp.position_command_error_tanh``.
    """
    return 1.0 - wp.tanh(position_command_error(env, robot, command, body_ids) / std)


@wp.func
def orientation_command_error(
    env: int, robot: ArticulationData, command: PoseCommandData, body_ids: wp.array[int]
) -> float:
    """Angle between the orientation of a link, the first of ``body_ids``, and the commanded one (a penalty).

    Formula: ``angle(q_body, q_root c)`` [rad], in [0, pi].

    Source: Isaac Lab, ``mdp.orientation_command_error``.
    """
    root = wp.transform_get_rotation(robot.root_pose[env])
    body = wp.transform_get_rotation(robot.body_pose[env, body_ids[0]])
    return frames.quat_error_magnitude(body, root * wp.transform_get_rotation(command.pose[env]))
