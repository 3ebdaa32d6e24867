# SPDX-License-Identifier: Apache-2.0
"""Terminations: ``term(env, ...) -> bool``, True where the episode of one environment ends.

A comparison with NaN is False, so that these terms ignore a diverged world; the termination manager ends its episode.
"""

import warp as wp

from ..data import ArticulationData, CommandData, EpisodeData
from . import frames

__all__ = [
    "bad_orientation",
    "command_resample",
    "joint_effort_out_of_limit",
    "joint_pos_out_of_limit",
    "joint_pos_out_of_manual_limit",
    "joint_vel_out_of_limit",
    "joint_vel_out_of_manual_limit",
    "root_height_below_minimum",
    "time_out",
]


@wp.func
def time_out(env: int, episode: EpisodeData) -> bool:
    """Time-out: the episode has reached its maximum length.

    Formula: ``n >= n_max``, ``n`` the steps taken.

    Source: Isaac Lab, ``mdp.time_out``.
    """
    return episode.length[env] >= episode.max_length


@wp.func
def command_resample(env: int, command: CommandData, episode: EpisodeData, num_resamples: int) -> bool:
    """Termination if the last of ``num_resamples`` commands is about to be resampled.

    Formula: ``time_left <= dt and counter = num_resamples``, ``dt`` [s] of the environment.

    Source: Isaac Lab, ``mdp.command_resample``.
    """
    return command.time_left[env] <= episode.step_dt and command.counter[env] == num_resamples


@wp.func
def bad_orientation(env: int, robot: ArticulationData, limit_angle: float) -> bool:
    """Termination if the root tilts by more than an angle.

    Formula: ``angle(-g_b, z) > limit_angle`` [rad], ``g_b`` the direction of gravity in the root's frame.

    Source: Isaac Lab, ``mdp.bad_orientation``.
    """
    g = frames.projected_gravity_b(env, robot)
    return wp.atan2(wp.length(wp.vec2(g[0], g[1])), -g[2]) > limit_angle


@wp.func
def root_height_below_minimum(env: int, robot: ArticulationData, minimum_height: float) -> bool:
    """Termination if the root link is below a height in the world.

    Formula: ``p.z < minimum_height`` [m].

    Source: Isaac Lab, ``mdp.root_height_below_minimum``.
    """
    return wp.transform_get_translation(robot.root_pose[env])[2] < minimum_height


@wp.func
def joint_pos_out_of_limit(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> bool:
    """Termination if a joint is beyond its soft limits.

    Formula: ``any_i q_i < lower_i or q_i > upper_i`` [m or rad].

    Source: Isaac Lab, ``mdp.joint_pos_out_of_limit``.
    """
    out = wp.bool(False)
    for i in range(joint_ids.shape[0]):
        limits = frames.soft_joint_pos_limits(env, robot, joint_ids[i])
        pos = robot.joint_pos[env, joint_ids[i]]
        out = out or pos < limits[0] or pos > limits[1]
    return out


@wp.func
def joint_pos_out_of_manual_limit(env: int, robot: ArticulationData, joint_ids: wp.array[int], bounds: wp.vec2) -> bool:
    """Termination if a joint is outside given bounds.

    Formula: ``any_i q_i < bounds[0] or q_i > bounds[1]`` [m or rad].

    Source: Isaac Lab, ``mdp.joint_pos_out_of_manual_limit``.
    """
    out = wp.bool(False)
    for i in range(joint_ids.shape[0]):
        pos = robot.joint_pos[env, joint_ids[i]]
        out = out or pos < bounds[0] or pos > bounds[1]
    return out


@wp.func
def joint_vel_out_of_limit(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> bool:
    """Termination if a joint is faster than its rated speed.

    Formula: ``any_i |qd_i| > limit_i`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.joint_vel_out_of_limit``.
    """
    out = wp.bool(False)
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        out = out or wp.abs(robot.joint_vel[env, joint]) > robot.joint_vel_limit[env, joint]
    return out


@wp.func
def joint_vel_out_of_manual_limit(
    env: int, robot: ArticulationData, joint_ids: wp.array[int], max_velocity: float
) -> bool:
    """Termination if a joint is faster than a given speed.

    Formula: ``any_i |qd_i| > max_velocity`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.joint_vel_out_of_manual_limit``.
    """
    out = wp.bool(False)
    for i in range(joint_ids.shape[0]):
        out = out or wp.abs(robot.joint_vel[env, joint_ids[i]]) > max_velocity
    return out


@wp.func
def joint_effort_out_of_limit(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> bool:
    """Termination if a drive's computed effort exceeds its limit, at the present state.

    Formula: ``any_i |tau_i - t_i| > 1e-8 + 1e-5 |t_i|`` [N or N m], ``t = clamp(tau, -limit, limit)``, ``tau`` as in
    ``applied_torque_limits``.

    Source: Isaac Lab, ``mdp.joint_effort_out_of_limit``, there with the law as it was before the physics step.
    """
    out = wp.bool(False)
    for i in range(joint_ids.shape[0]):
        effort = frames.effort_excess(env, robot, joint_ids[i])
        out = out or effort[0] > 1.0e-8 + 1.0e-5 * wp.abs(effort[1])
    return out
