# SPDX-License-Identifier: Apache-2.0
"""Commands: ``resample_*`` draws a new command for one environment, ``update_*`` updates it in every step.

``COMMANDS`` pairs the functions under the names of Isaac Lab's command terms. A step runs ``advance_command``, then
``resample_*`` where it returned True, then ``update_*``. A reset runs ``restart_command`` and ``resample_*``.
"""

from typing import NamedTuple

import warp as wp

from ..data import ArticulationData, CommandData, Pose2dCommandData, PoseCommandData, VelocityCommandData
from . import frames, random
from .motion import resample_motion, update_motion
from .terrain import resample_terrain_based_pose_2d

__all__ = [
    "COMMANDS",
    "CommandTerm",
    "advance_command",
    "pose_2d_error_heading",
    "pose_2d_error_pos",
    "resample_normal_velocity",
    "resample_uniform_pose",
    "resample_uniform_pose_2d",
    "resample_uniform_velocity",
    "restart_command",
    "update_uniform_pose_2d",
    "update_uniform_velocity",
    "velocity_error_xy",
    "velocity_error_yaw",
]


# -- the clock


@wp.func
def restart_command(env: int, command: CommandData, rng: wp.array[wp.uint32], resampling_time_range: wp.vec2):
    """Start the resampling clock at the start of an episode.

    Formula: ``time_left = U(resampling_time_range)`` [s], ``counter = 1``.

    Source: Isaac Lab, ``CommandTerm.reset``.
    """
    command.time_left[env] = random.uniform_range(env, rng, resampling_time_range)
    command.counter[env] = 1


@wp.func
def advance_command(
    env: int, command: CommandData, rng: wp.array[wp.uint32], resampling_time_range: wp.vec2, step_dt: float
) -> bool:
    """Advance the resampling clock by a step; returns whether a new command is due, and restarts the clock if so.

    Formula: ``time_left = time_left - step_dt`` [s]; where that is ``<= 0``: ``time_left = U(resampling_time_range)``,
    ``counter = counter + 1``.

    Source: Isaac Lab, ``CommandTerm.compute``.
    """
    left = command.time_left[env] - step_dt
    due = left <= 0.0
    if due:
        left = random.uniform_range(env, rng, resampling_time_range)
        command.counter[env] = command.counter[env] + 1
    command.time_left[env] = left
    return due


# -- velocity


@wp.func
def resample_uniform_velocity(
    env: int,
    command: VelocityCommandData,
    rng: wp.array[wp.uint32],
    lin_vel_x: wp.vec2,
    lin_vel_y: wp.vec2,
    ang_vel_z: wp.vec2,
    heading: wp.vec2,
    rel_heading_envs: float,
    rel_standing_envs: float,
):
    """Draw a uniform velocity command; with ``rel_heading_envs = 0`` no environment has a heading.

    Formula: ``c = (U(lin_vel_x), U(lin_vel_y), U(ang_vel_z))`` [m/s, m/s, rad/s], heading ``U(heading)`` [rad]; the
    share ``rel_heading_envs`` turns to the heading, the share ``rel_standing_envs`` stands.

    Source: Isaac Lab, ``UniformVelocityCommand``.
    """
    # Six draws in a fixed order, whatever the options: an environment's stream does not depend on them.
    command.command[env, 0] = random.uniform_range(env, rng, lin_vel_x)
    command.command[env, 1] = random.uniform_range(env, rng, lin_vel_y)
    command.command[env, 2] = random.uniform_range(env, rng, ang_vel_z)
    command.heading_target[env] = random.uniform_range(env, rng, heading)
    command.is_heading[env] = random.bernoulli(env, rng, rel_heading_envs)
    command.is_standing[env] = random.bernoulli(env, rng, rel_standing_envs)


@wp.func
def update_uniform_velocity(
    env: int,
    command: VelocityCommandData,
    robot: ArticulationData,
    heading_control_stiffness: float,
    ang_vel_z: wp.vec2,
):
    """Update a velocity command: compute the yaw rate from the heading's error, or set the command to zero to stand.

    Formula: ``c.yaw = clamp(k wrap(heading - yaw), ang_vel_z)`` [rad/s], ``k = heading_control_stiffness`` [1/s], where
    the command has a heading; ``c = 0`` where it is to stand.

    Source: Isaac Lab, ``UniformVelocityCommand``.
    """
    if command.is_heading[env]:
        error = frames.wrap_to_pi(command.heading_target[env] - frames.heading_w(env, robot))
        command.command[env, 2] = wp.clamp(heading_control_stiffness * error, ang_vel_z[0], ang_vel_z[1])
    if command.is_standing[env]:  # after the heading: standing overrides it
        for k in range(3):
            command.command[env, k] = 0.0


@wp.func
def resample_normal_velocity(
    env: int,
    command: VelocityCommandData,
    rng: wp.array[wp.uint32],
    mean_vel: wp.vec3,
    std_vel: wp.vec3,
    zero_prob: wp.vec3,
    rel_standing_envs: float,
):
    """Draw a normal velocity command around the mean, with random sign; it needs no update.

    Formula: ``c_k = s N(mean_vel_k, std_vel_k)`` [m/s, m/s, rad/s], ``s`` 1 or -1 with equal chance, 0 with chance
    ``zero_prob_k``; ``c = 0`` for the share ``rel_standing_envs`` that stands.

    Source: Isaac Lab, ``NormalVelocityCommand``.
    """
    standing = random.bernoulli(env, rng, rel_standing_envs)
    for k in range(3):
        value = random.gaussian(env, rng, mean_vel[k], std_vel[k])
        if random.bernoulli(env, rng, 0.5):
            value = -value
        if random.bernoulli(env, rng, zero_prob[k]) or standing:
            value = 0.0
        command.command[env, k] = value
    command.is_heading[env] = False
    command.is_standing[env] = standing


@wp.func
def velocity_error_xy(env: int, command: VelocityCommandData, robot: ArticulationData) -> float:
    """Error of the horizontal velocity in the root's frame, for the metric ``error_vel_xy``.

    Formula: ``|(c.x - v_b.x, c.y - v_b.y)|`` [m/s].

    Source: Isaac Lab, ``UniformVelocityCommand``.
    """
    v = frames.root_lin_vel_b(env, robot)
    return wp.length(wp.vec2(command.command[env, 0] - v[0], command.command[env, 1] - v[1]))


@wp.func
def velocity_error_yaw(env: int, command: VelocityCommandData, robot: ArticulationData) -> float:
    """Error of the yaw rate in the root's frame, for the metric ``error_vel_yaw``.

    Formula: ``|c.yaw - w_b.z|`` [rad/s].

    Source: Isaac Lab, ``UniformVelocityCommand``.
    """
    return wp.abs(command.command[env, 2] - frames.root_ang_vel_b(env, robot)[2])


# -- pose


@wp.func
def resample_uniform_pose(
    env: int,
    command: PoseCommandData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    make_quat_unique: bool,
):
    """Draw a uniform pose command in the root's frame from six bounds: x, y, z [m], roll, pitch, yaw [rad].

    Formula: ``p = U`` [m], ``q = Rz(U) Ry(U) Rx(U)``; with ``make_quat_unique`` that of ``q`` and ``-q`` with
    ``w >= 0``.

    Source: Isaac Lab, ``UniformPoseCommand``.
    """
    pos = random.uniform_vec3(env, rng, pose_range, 0)
    angles = random.uniform_vec3(env, rng, pose_range, 3)
    q = wp.quat_rpy(angles[0], angles[1], angles[2])
    if make_quat_unique:
        q = frames.quat_unique(q)
    command.pose[env] = wp.transform(pos, q)


@wp.func
def resample_uniform_pose_2d(
    env: int,
    command: Pose2dCommandData,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    pos_x: wp.vec2,
    pos_y: wp.vec2,
    heading: wp.vec2,
    simple_heading: bool,
):
    """Draw a position around the environment's origin, at the default height of the root, and a heading.

    Formula: ``p = origin + (U(pos_x), U(pos_y), p_default.z)`` [m]; heading ``U(heading)`` [rad], or with
    ``simple_heading`` the direction to the position or the opposite one, whichever needs the smaller turn.

    Source: Isaac Lab, ``UniformPose2dCommand``.
    """
    x = random.uniform_range(env, rng, pos_x)
    y = random.uniform_range(env, rng, pos_y)
    # Drawn with ``simple_heading`` too, so that a switch of the option leaves all other draws as they are.
    target = random.uniform_range(env, rng, heading)
    height = wp.transform_get_translation(robot.default_root_pose[env])[2]
    pos = robot.env_origin[env] + wp.vec3(x, y, height)
    if simple_heading:
        way = pos - wp.transform_get_translation(robot.root_pose[env])
        target = wp.atan2(way[1], way[0])
        turn = wp.abs(frames.wrap_to_pi(target - frames.heading_w(env, robot)))
        if turn >= 0.5 * wp.pi:  # walk there backwards
            target = frames.wrap_to_pi(target + wp.pi)
    command.pos[env] = pos
    command.heading[env] = target


@wp.func
def update_uniform_pose_2d(env: int, command: Pose2dCommandData, robot: ArticulationData):
    """Update a position command: express position and heading relative to the root, in its yaw frame.

    Formula: ``(Rz(yaw)^T (p - p_root), wrap(heading - yaw))`` [m, rad].

    Source: Isaac Lab, ``UniformPose2dCommand``.
    """
    pose = robot.root_pose[env]
    way = command.pos[env] - wp.transform_get_translation(pose)
    local = frames.rotate_inverse_yaw(wp.transform_get_rotation(pose), way)
    for k in range(3):
        command.command[env, k] = local[k]
    command.command[env, 3] = frames.wrap_to_pi(command.heading[env] - frames.heading_w(env, robot))


@wp.func
def pose_2d_error_pos(env: int, command: Pose2dCommandData, robot: ArticulationData) -> float:
    """Horizontal distance from the root to the commanded position, for the metric ``error_pos_2d``.

    Formula: ``|(p.x - p_root.x, p.y - p_root.y)|`` [m].

    Source: Isaac Lab, ``UniformPose2dCommand``.
    """
    way = command.pos[env] - wp.transform_get_translation(robot.root_pose[env])
    return wp.length(wp.vec2(way[0], way[1]))


@wp.func
def pose_2d_error_heading(env: int, command: Pose2dCommandData, robot: ArticulationData) -> float:
    """Angle between the root's heading and the commanded one, for the metric ``error_heading``.

    Formula: ``|wrap(heading - yaw)|`` [rad].

    Source: Isaac Lab, ``UniformPose2dCommand``.
    """
    return wp.abs(frames.wrap_to_pi(command.heading[env] - frames.heading_w(env, robot)))


class CommandTerm(NamedTuple):
    """Functions of a command term, and its size."""

    resample: wp.Function | None
    """Function that draws a new command; None for a command that comes with functions of its own."""
    update: wp.Function | None
    """Function that updates the command in every step; None where there is nothing to update."""
    size: int
    """Number of floats in the command; 0 where it depends on the robot."""


COMMANDS: dict[str, CommandTerm] = {
    "UniformVelocityCommand": CommandTerm(resample_uniform_velocity, update_uniform_velocity, 3),
    "NormalVelocityCommand": CommandTerm(resample_normal_velocity, None, 3),
    "UniformPoseCommand": CommandTerm(resample_uniform_pose, None, 7),
    "UniformPose2dCommand": CommandTerm(resample_uniform_pose_2d, update_uniform_pose_2d, 4),
    "TerrainBasedPose2dCommand": CommandTerm(resample_terrain_based_pose_2d, update_uniform_pose_2d, 4),
    "MotionCommand": CommandTerm(resample_motion, update_motion, 0),
}
"""Command terms by the names of Isaac Lab's classes."""
