# SPDX-License-Identifier: Apache-2.0
"""Events: ``term(env, ..., rng, ...)`` changes the state of one environment.

Joint positions and velocities are written as state, not as targets; link poses follow once forward kinematics ran.
``pose_range`` and ``velocity_range`` hold six bounds (low, high): x, y, z [m or m/s], then roll, pitch, yaw [rad] or
rates about x, y, z [rad/s].

``interval_is_due`` and ``reset_is_due`` are no terms: by them a manager finds where a term runs.
"""

import warp as wp

from ..data import ArticulationData
from ..term_info import for_each_asset
from . import frames, random

__all__ = [
    "apply_external_force_torque",
    "push_by_setting_velocity",
    "reset_joint_targets_to_default",
    "reset_joints_by_offset",
    "reset_joints_by_scale",
    "reset_joints_to_default",
    "reset_joints_within_limits_range",
    "reset_root_state_uniform",
    "reset_root_state_with_random_orientation",
    "reset_root_to_default",
    "reset_scene_to_default",
]


@wp.func
def _write_joint(env: int, robot: ArticulationData, joint: int, pos: float, vel: float):
    """Write the state of a joint, limited to its soft limits and its rated speed."""
    limits = frames.soft_joint_pos_limits(env, robot, joint)
    speed = robot.joint_vel_limit[env, joint]
    robot.joint_pos[env, joint] = wp.clamp(pos, limits[0], limits[1])
    robot.joint_vel[env, joint] = wp.clamp(vel, -speed, speed)


@wp.func
def reset_joints_by_offset(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    position_range: wp.vec2,
    velocity_range: wp.vec2,
):
    """Put joints near their state at the start of an episode, a random offset away.

    Formula: ``q_i = clamp(q_default,i + U(position_range))`` [m or rad] to the soft limits, ``qd_i`` likewise to the
    rated speeds.

    Source: Isaac Lab, ``mdp.reset_joints_by_offset``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        pos = robot.default_joint_pos[env, joint] + random.uniform_range(env, rng, position_range)
        vel = robot.default_joint_vel[env, joint] + random.uniform_range(env, rng, velocity_range)
        _write_joint(env, robot, joint, pos, vel)


@wp.func
def reset_joints_by_scale(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    position_range: wp.vec2,
    velocity_range: wp.vec2,
):
    """Put joints at random multiples of their state at the start of an episode.

    Formula: ``q_i = clamp(q_default,i U(position_range))`` [m or rad] to the soft limits, ``qd_i`` likewise to the
    rated speeds.

    Source: Isaac Lab, ``mdp.reset_joints_by_scale``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        pos = robot.default_joint_pos[env, joint] * random.uniform_range(env, rng, position_range)
        vel = robot.default_joint_vel[env, joint] * random.uniform_range(env, rng, velocity_range)
        _write_joint(env, robot, joint, pos, vel)


@wp.func
def _within(bounds: wp.vec2, limits: wp.vec2, scale: bool, offset: float) -> wp.vec2:
    """Bounds to draw from: those given, or shares of the limits; a bound that is not a number is the limit."""
    low = limits[0]
    high = limits[1]
    if not wp.isnan(bounds[0]):
        low = wp.where(scale, bounds[0] * limits[0], bounds[0])
    if not wp.isnan(bounds[1]):
        high = wp.where(scale, bounds[1] * limits[1], bounds[1])
    return wp.vec2(low + offset, high + offset)


@wp.func
def reset_joints_within_limits_range(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    position_joint_ids: wp.array[int],
    position_range: wp.array[wp.vec2],
    velocity_joint_ids: wp.array[int],
    velocity_range: wp.array[wp.vec2],
    use_default_offset: bool,
    scale: bool,
):
    """Put joints anywhere in ranges of their own; all others, as at the start of an episode.

    Formula: ``q_i = clamp(U(range_i))`` [m or rad] to the soft limits, with ``range_i`` as given, or with ``scale``
    (operation "scale") times the lower and the upper soft limit; a bound that is NaN is the limit; with
    ``use_default_offset`` plus ``q_default,i``. Velocities likewise with plus and minus the rated speeds.

    Source: Isaac Lab, ``mdp.reset_joints_within_limits_range``, there with ``operation="abs"`` or ``"scale"``.
    """
    reset_joints_to_default(env, robot)
    for i in range(position_joint_ids.shape[0]):
        joint = position_joint_ids[i]
        limits = frames.soft_joint_pos_limits(env, robot, joint)
        offset = wp.where(use_default_offset, robot.default_joint_pos[env, joint], 0.0)
        pos = random.uniform_range(env, rng, _within(position_range[i], limits, scale, offset))
        robot.joint_pos[env, joint] = wp.clamp(pos, limits[0], limits[1])
    for i in range(velocity_joint_ids.shape[0]):
        joint = velocity_joint_ids[i]
        speed = robot.joint_vel_limit[env, joint]
        offset = wp.where(use_default_offset, robot.default_joint_vel[env, joint], 0.0)
        vel = random.uniform_range(env, rng, _within(velocity_range[i], wp.vec2(-speed, speed), scale, offset))
        robot.joint_vel[env, joint] = wp.clamp(vel, -speed, speed)


@wp.func
def reset_root_state_uniform(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
):
    """Put the root near its state at the start of an episode, random offsets away.

    Formula: ``p = p_default + origin + U`` [m], ``q = q_default Rz(U) Ry(U) Rx(U)``, ``v = v_default + U``
    [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_root_state_uniform``.
    """
    pose = robot.default_root_pose[env]
    offset = random.uniform_vec3(env, rng, pose_range, 0)
    angles = random.uniform_vec3(env, rng, pose_range, 3)
    pos = wp.transform_get_translation(pose) + robot.env_origin[env] + offset
    rot = wp.transform_get_rotation(pose) * wp.quat_rpy(angles[0], angles[1], angles[2])
    robot.root_pose[env] = wp.transform(pos, rot)
    robot.root_vel[env] = robot.default_root_vel[env] + random.uniform_twist(env, rng, velocity_range)


@wp.func
def reset_root_state_with_random_orientation(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
):
    """Put the root near its place at the start of an episode, turned any way; of ``pose_range`` x, y, z count.

    Formula: ``p = p_default + origin + U`` [m], ``q`` uniform over all rotations, ``v = v_default + U`` [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_root_state_with_random_orientation``.
    """
    offset = random.uniform_vec3(env, rng, pose_range, 0)
    pos = wp.transform_get_translation(robot.default_root_pose[env]) + robot.env_origin[env] + offset
    robot.root_pose[env] = wp.transform(pos, random.random_quat(env, rng))
    robot.root_vel[env] = robot.default_root_vel[env] + random.uniform_twist(env, rng, velocity_range)


@wp.func
def reset_root_to_default(env: int, robot: ArticulationData):
    """Put the root where it is at the start of an episode: part of ``reset_scene_to_default``.

    Formula: ``p = p_default + origin`` [m], ``q = q_default``, ``v = v_default`` [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_scene_to_default``.
    """
    pose = robot.default_root_pose[env]
    pos = wp.transform_get_translation(pose) + robot.env_origin[env]
    robot.root_pose[env] = wp.transform(pos, wp.transform_get_rotation(pose))
    robot.root_vel[env] = robot.default_root_vel[env]


@wp.func
def reset_joints_to_default(env: int, robot: ArticulationData):
    """Put all joints where they are at the start of an episode: part of ``reset_scene_to_default``.

    Formula: ``q = q_default`` [m or rad], ``qd = qd_default`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.reset_scene_to_default``.
    """
    for j in range(robot.joint_pos.shape[1]):
        robot.joint_pos[env, j] = robot.default_joint_pos[env, j]
    for j in range(robot.joint_vel.shape[1]):
        robot.joint_vel[env, j] = robot.default_joint_vel[env, j]


@wp.func
def reset_joint_targets_to_default(env: int, robot: ArticulationData):
    """Set the targets of all joints to their state at the start of an episode: part of ``reset_scene_to_default``.

    Formula: ``q* = q_default`` [m or rad], ``qd* = qd_default`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.reset_scene_to_default``, there with ``reset_joint_targets``.
    """
    for j in range(robot.joint_pos_target.shape[1]):
        robot.joint_pos_target[env, j] = robot.default_joint_pos[env, j]
    for j in range(robot.joint_vel_target.shape[1]):
        robot.joint_vel_target[env, j] = robot.default_joint_vel[env, j]


@for_each_asset
@wp.func
def reset_scene_to_default(env: int, robot: ArticulationData, reset_joint_targets: bool = True):
    """Put root and joints where they are at the start of an episode; with ``reset_joint_targets`` the targets, too.

    Formula: ``p = p_default + origin`` [m], ``quat = quat_default``, ``v = v_default`` [m/s, rad/s], ``q = q_default``,
    ``qd = qd_default``, ``q* = q_default`` [m or rad], ``qd* = qd_default`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.reset_scene_to_default``; an event manager runs it for all assets if none is named.
    """
    reset_root_to_default(env, robot)
    reset_joints_to_default(env, robot)
    if reset_joint_targets:
        reset_joint_targets_to_default(env, robot)


@wp.func
def push_by_setting_velocity(
    env: int, robot: ArticulationData, rng: wp.array[wp.uint32], velocity_range: wp.array[wp.vec2]
):
    """Push the root: change its velocity at random.

    Formula: ``v = v + U`` [m/s, rad/s].

    Source: Isaac Lab, ``mdp.push_by_setting_velocity``.
    """
    robot.root_vel[env] = robot.root_vel[env] + random.uniform_twist(env, rng, velocity_range)


@wp.func
def apply_external_force_torque(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    body_ids: wp.array[int],
    force_range: wp.vec2,
    torque_range: wp.vec2,
):
    """Let a random wrench act on bodies about their centres of mass, until it is changed.

    Formula: ``f_i = U(force_range)`` [N], ``t_i = U(torque_range)`` [N m], each component on its own.

    Source: Isaac Lab, ``mdp.apply_external_force_torque``.
    """
    for i in range(body_ids.shape[0]):
        fx = random.uniform_range(env, rng, force_range)
        fy = random.uniform_range(env, rng, force_range)
        fz = random.uniform_range(env, rng, force_range)
        tx = random.uniform_range(env, rng, torque_range)
        ty = random.uniform_range(env, rng, torque_range)
        tz = random.uniform_range(env, rng, torque_range)
        robot.external_wrench[env, body_ids[i]] = wp.spatial_vector(fx, fy, fz, tx, ty, tz)


@wp.func
def interval_is_due(
    env: int, rng: wp.array[wp.uint32], steps_left: wp.array[int], interval_range_s: wp.vec2, step_dt: float
) -> bool:
    """Let a step pass on a clock, and say whether its time is up; a clock at 0 draws a new time first.

    Formula: up after ``n = max(1, ceil(U(interval_range_s) / step_dt - 0.001))`` steps: the first multiple of
    ``step_dt`` that is not earlier, but for rounding.
    """
    left = steps_left[env]
    if left <= 0:
        time = random.uniform_range(env, rng, interval_range_s)
        left = wp.int32(wp.clamp(wp.ceil(time / step_dt - 1.0e-3), 1.0, 2.0e9))
    left = left - 1
    steps_left[env] = left
    return left == 0


@wp.func
def reset_is_due(env: int, step: wp.array[wp.int64], last_run: wp.array[wp.int64], min_steps: int) -> bool:
    """Whether a term that runs at resets may run again, noted if so; it may if it never did.

    ``last_run`` holds ``step[0] + 1`` of the last run, 0 before the first.

    Formula: ``step[0] + 1 - last_run >= min_steps``.
    """
    now = step[0] + wp.int64(1)
    due = last_run[env] == wp.int64(0) or now - last_run[env] >= wp.int64(min_steps)
    if due:
        last_run[env] = now
    return due
