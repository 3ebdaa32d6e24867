# SPDX-License-Identifier: Apache-2.0
"""Getup terms: how high the body is, and how still and straight a robot stands once it is up."""

import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_kernels.mdp import frames

__all__ = ["body_height_exp", "joint_vel_standing_exp", "posture_standing_exp", "stands"]


@wp.func
def _height(env: int, robot: ArticulationData, body: int) -> float:
    """Height of a body's frame above the environment's origin [m]."""
    return wp.transform_get_translation(robot.body_pose[env, body])[2] - robot.env_origin[env][2]


@wp.func
def body_height_exp(
    env: int, robot: ArticulationData, body_ids: wp.array[int], target_height: float, std: float
) -> float:
    """Nearness of a body to the height at which it is when the robot stands, from 0 to 1; higher is no worse.

    Formula: ``exp(-max(target_height - z, 0)^2 / std^2)``.
    """
    lacking = wp.max(target_height - _height(env, robot, body_ids[0]), 0.0)
    return wp.exp(-lacking * lacking / (std * std))


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


@wp.func
def stands(
    env: int,
    reached: wp.array[int],
    robot: ArticulationData,
    body_ids: wp.array[int],
    least_height: float,
    largest_tilt: float,
) -> None:
    """Record whether the robot stands: a body is above a height, and the root is upright within an angle [rad]."""
    upright = -frames.projected_gravity_b(env, robot)[2] > wp.cos(largest_tilt)
    reached[env] = wp.where(upright and _is_up(env, robot, body_ids[0], least_height) > 0.0, 1, 0)
