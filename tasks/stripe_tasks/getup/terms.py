# SPDX-License-Identifier: Apache-2.0
"""Getup terms: how high and upright a body is, and how still and straight a robot stands once it is up."""

import warp as wp

from stripe_kernels.data import ArticulationData

__all__ = ["head_height", "head_height_exp", "joint_vel_standing_exp", "posture_standing_exp", "uprightness"]


@wp.func
def _height(env: int, robot: ArticulationData, body: int) -> float:
    """Height of a body's frame above the environment's origin [m]."""
    return wp.transform_get_translation(robot.body_pose[env, body])[2] - robot.env_origin[env][2]


@wp.func
def _head_height(env: int, robot: ArticulationData, body: int, length: float) -> float:
    """Height of the point that is so far along the z axis of a body's frame, above the environment's origin [m]."""
    up = wp.quat_rotate(wp.transform_get_rotation(robot.body_pose[env, body]), wp.vec3(0.0, 0.0, 1.0))
    return _height(env, robot, body) + length * up[2]


@wp.func
def head_height(
    env: int, robot: ArticulationData, body_ids: wp.array[int], length: float, target_height: float
) -> float:
    """Height of the head as a share of that when the robot stands, from 0 to 1.

    The head is the point at ``length`` on the z axis of a body, so that a robot that stands on its head gains nothing.

    Formula: ``clamp(z / target_height, 0, 1)``.
    """
    return wp.clamp(_head_height(env, robot, body_ids[0], length) / target_height, 0.0, 1.0)


@wp.func
def head_height_exp(
    env: int, robot: ArticulationData, body_ids: wp.array[int], length: float, target_height: float, std: float
) -> float:
    """Nearness of the head to the height at which it is when the robot stands, from 0 to 1; higher is no worse.

    Formula: ``exp(-max(target_height - z, 0)^2 / std^2)``, the head as in :func:`head_height`.
    """
    lacking = wp.max(target_height - _head_height(env, robot, body_ids[0], length), 0.0)
    return wp.exp(-lacking * lacking / (std * std))


@wp.func
def uprightness(env: int, robot: ArticulationData, body_ids: wp.array[int]) -> float:
    """Uprightness of a body, from 0 if it is upside down to 1.

    Formula: ``((1 + cos a) / 2)^2``, ``a`` the angle of its z axis from the vertical.
    """
    up = wp.quat_rotate(wp.transform_get_rotation(robot.body_pose[env, body_ids[0]]), wp.vec3(0.0, 0.0, 1.0))
    half = 0.5 * (1.0 + up[2])
    return half * half


@wp.func
def _is_up(env: int, robot: ArticulationData, body: int, least_height: float) -> float:
    """1 where a body is above a height, else 0."""
    return wp.where(_height(env, robot, body) > least_height, 1.0, 0.0)


@wp.func
def posture_standing_exp(
    env: int,
    robot: ArticulationData,
    body_ids: wp.array[int],
    joint_ids: wp.array[int],
    least_height: float,
    std: float,
) -> float:
    """Nearness of the joints to the default pose once a body is above a height, from 0 to 1.

    Formula: ``(z > least_height) exp(-mean_i (q_i - q_default,i)^2 / std^2)``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        error = robot.joint_pos[env, joint_ids[i]] - robot.default_joint_pos[env, joint_ids[i]]
        total += error * error
    near = wp.exp(-total / (float(wp.max(joint_ids.shape[0], 1)) * std * std))
    return near * _is_up(env, robot, body_ids[0], least_height)


@wp.func
def joint_vel_standing_exp(
    env: int,
    robot: ArticulationData,
    body_ids: wp.array[int],
    joint_ids: wp.array[int],
    least_height: float,
    std: float,
) -> float:
    """Stillness of the joints once a body is above a height, from 0 to 1.

    Formula: ``(z > least_height) exp(-mean_i qd_i^2 / std^2)``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        speed = robot.joint_vel[env, joint_ids[i]]
        total += speed * speed
    still = wp.exp(-total / (float(wp.max(joint_ids.shape[0], 1)) * std * std))
    return still * _is_up(env, robot, body_ids[0], least_height)
