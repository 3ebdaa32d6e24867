# SPDX-License-Identifier: Apache-2.0
"""Walking rewards: the terms by which mjlab's velocity tasks shape a gait, ``term(env, ...) -> float``."""

import warp as wp

from ..data import ArticulationData, VelocityCommandData
from . import frames

__all__ = [
    "body_angular_velocity_penalty",
    "track_angular_velocity",
    "track_linear_velocity",
    "upright",
    "variable_posture",
]


@wp.func
def track_linear_velocity(env: int, robot: ArticulationData, command: VelocityCommandData, std: float) -> float:
    """Tracking of the horizontal velocity command without vertical velocity, exponential kernel, from 0 to 1.

    Formula: ``exp(-((c.x - v_b.x)^2 + (c.y - v_b.y)^2 + v_b.z^2) / std^2)``, ``std`` [m/s].

    Source: mjlab, ``mdp.track_linear_velocity`` of its velocity task, there of the root link's origin.
    """
    v = frames.root_lin_vel_b(env, robot)
    error = wp.vec3(command.command[env, 0] - v[0], command.command[env, 1] - v[1], v[2])
    return wp.exp(-wp.length_sq(error) / (std * std))


@wp.func
def track_angular_velocity(env: int, robot: ArticulationData, command: VelocityCommandData, std: float) -> float:
    """Tracking of the yaw rate command without roll and pitch rates, exponential kernel, from 0 to 1.

    Formula: ``exp(-((c.yaw - w_b.z)^2 + w_b.x^2 + w_b.y^2) / std^2)``, ``std`` [rad/s].

    Source: mjlab, ``mdp.track_angular_velocity`` of its velocity task.
    """
    w = frames.root_ang_vel_b(env, robot)
    return wp.exp(-wp.length_sq(wp.vec3(w[0], w[1], command.command[env, 2] - w[2])) / (std * std))


@wp.func
def upright(env: int, robot: ArticulationData, body_ids: wp.array[int], std: float) -> float:
    """Uprightness of bodies, exponential kernel, from 0 to 1.

    Formula: ``exp(-sum_i (g_i.x^2 + g_i.y^2) / std^2)``, ``g_i`` the direction of gravity in the frame of body ``i``.

    Source: mjlab, ``mdp.upright`` of its velocity task, there of one body.
    """
    tilt = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        rot = wp.transform_get_rotation(robot.body_pose[env, body_ids[i]])
        g = wp.quat_rotate_inv(rot, robot.gravity_dir)
        tilt += g[0] * g[0] + g[1] * g[1]
    return wp.exp(-tilt / (std * std))


@wp.func
def body_angular_velocity_penalty(env: int, robot: ArticulationData, body_ids: wp.array[int]) -> float:
    """Squared angular velocity of bodies about the horizontal axes of the world, summed (a penalty).

    Formula: ``sum_i (w_i.x^2 + w_i.y^2)`` [rad^2/s^2].

    Source: mjlab, ``mdp.body_angular_velocity_penalty`` of its velocity task, there of one body.
    """
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        w = wp.spatial_bottom(robot.body_vel[env, body_ids[i]])
        total += w[0] * w[0] + w[1] * w[1]
    return total


@wp.func
def variable_posture(
    env: int,
    robot: ArticulationData,
    command: VelocityCommandData,
    joint_ids: wp.array[int],
    std_standing: wp.array[float],
    std_walking: wp.array[float],
    std_running: wp.array[float],
    walking_threshold: float,
    running_threshold: float,
) -> float:
    """Nearness of joints to their default positions, the less strict the faster the command, from 0 to 1.

    Formula: ``exp(-mean_i ((q_i - q_default,i) / std_i)^2)``; ``s = |c.xy| + |c.yaw|`` selects ``std_standing`` where
    ``s < walking_threshold``, ``std_running`` where ``s >= running_threshold``, else ``std_walking`` [m or rad], each
    with a number for every joint.

    Source: mjlab, ``mdp.variable_posture`` of its velocity task.
    """
    c = command.command[env]
    speed = wp.length(wp.vec2(c[0], c[1])) + wp.abs(c[2])
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        std = std_walking[i]
        if speed < walking_threshold:
            std = std_standing[i]
        elif speed >= running_threshold:
            std = std_running[i]
        error = (robot.joint_pos[env, joint_ids[i]] - robot.default_joint_pos[env, joint_ids[i]]) / std
        total += error * error
    return wp.exp(-total / float(wp.max(joint_ids.shape[0], 1)))
