# SPDX-License-Identifier: Apache-2.0
"""Events: ``term(env, ..., rng, ...)`` changes the state of one environment.

Joint positions and velocities are written as state, not as targets; link poses are updated when forward kinematics
runs. ``pose_range`` and ``velocity_range`` hold six bounds (low, high): x, y, z [m or m/s], then roll, pitch, yaw [rad]
or rates about x, y, z [rad/s].

``interval_is_due`` and ``reset_is_due`` are no terms: a manager decides with them in which environments a term runs.
"""

import warp as wp

from ..data import ArticulationData
from ..term_info import for_each_asset, resets
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
    """Write position [m or rad] and velocity of a joint, limited to its soft limits and its rated speed."""
    limits = frames.soft_joint_pos_limits(env, robot, joint)
    speed = robot.joint_vel_limit[env, joint]
    robot.joint_pos[env, joint] = wp.clamp(pos, limits[0], limits[1])
    robot.joint_vel[env, joint] = wp.clamp(vel, -speed, speed)


@resets("joints")
@wp.func
def reset_joints_by_offset(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    position_range: wp.vec2,
    velocity_range: wp.vec2,
):
    """Reset joints to their default state plus a random offset.

    Formula: ``q_i = clamp(q_default,i + U(position_range))`` [m or rad] to the soft limits, ``qd_i`` likewise to the
    rated speeds.

    Source: Isaac Lab, ``mdp.reset_joints_by_offset``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        pos = robot.default_joint_pos[env, joint] + random.uniform_range(env, rng, position_range)
        vel = robot.default_joint_vel[env, joint] + random.uniform_range(env, rng, velocity_range)
        _write_joint(env, robot, joint, pos, vel)


@resets("joints")
@wp.func
def reset_joints_by_scale(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    position_range: wp.vec2,
    velocity_range: wp.vec2,
):
    """Reset joints to random multiples of their default state.

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
def _draw_bounds(bounds: wp.vec2, limits: wp.vec2, scale: bool, offset: float) -> wp.vec2:
    """Bounds of a draw: ``bounds``, or with ``scale`` multiples of the limits; a bound that is NaN is the limit."""
    low = limits[0]
    high = limits[1]
    if not wp.isnan(bounds[0]):
        low = wp.where(scale, bounds[0] * limits[0], bounds[0])
    if not wp.isnan(bounds[1]):
        high = wp.where(scale, bounds[1] * limits[1], bounds[1])
    return wp.vec2(low + offset, high + offset)


@resets("joints")
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
    """Reset joints uniformly within a range for each, and all other joints to their default state.

    Formula: ``q_i = clamp(U(range_i))`` [m or rad] to the soft limits, with ``range_i`` as given, or with ``scale``
    (operation "scale") times the lower and the upper soft limit; a bound that is NaN is the limit; with
    ``use_default_offset`` plus ``q_default,i``. Velocities likewise with plus and minus the rated speeds.

    Source: Isaac Lab, ``mdp.reset_joints_within_limits_range``, there with ``operation="abs"`` or ``"scale"``.
    """
    reset_joints_to_default(env, robot)  # first: joints without a range keep these values
    for i in range(position_joint_ids.shape[0]):
        joint = position_joint_ids[i]
        limits = frames.soft_joint_pos_limits(env, robot, joint)
        offset = wp.where(use_default_offset, robot.default_joint_pos[env, joint], 0.0)
        pos = random.uniform_range(env, rng, _draw_bounds(position_range[i], limits, scale, offset))
        robot.joint_pos[env, joint] = wp.clamp(pos, limits[0], limits[1])
    for i in range(velocity_joint_ids.shape[0]):
        joint = velocity_joint_ids[i]
        speed = robot.joint_vel_limit[env, joint]
        offset = wp.where(use_default_offset, robot.default_joint_vel[env, joint], 0.0)
        vel = random.uniform_range(env, rng, _draw_bounds(velocity_range[i], wp.vec2(-speed, speed), scale, offset))
        robot.joint_vel[env, joint] = wp.clamp(vel, -speed, speed)


@resets("root")
@wp.func
def reset_root_state_uniform(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
):
    """Reset the root to its default state plus random offsets.

    Formula: ``p = p_default + origin + U`` [m], ``q = q_default Rz(U) Ry(U) Rx(U)``, ``v = v_default + U``
    [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_root_state_uniform``.
    """
    pose = robot.default_root_pose[env]
    offset = random.uniform_vec3(env, rng, pose_range, 0)
    angles = random.uniform_vec3(env, rng, pose_range, 3)
    pos = wp.transform_get_translation(pose) + robot.env_origin[env] + offset
    # The offset is along the world's axes, the angles are about the root's own, as in Isaac Lab.
    rot = wp.transform_get_rotation(pose) * wp.quat_rpy(angles[0], angles[1], angles[2])
    robot.root_pose[env] = wp.transform(pos, rot)
    robot.root_vel[env] = robot.default_root_vel[env] + random.uniform_twist(env, rng, velocity_range)


@resets("root")
@wp.func
def reset_root_state_with_random_orientation(
    env: int,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
):
    """Reset the root to its default position plus a random offset, with a random orientation.

    The angles of ``pose_range`` are ignored.

    Formula: ``p = p_default + origin + U`` [m], ``q`` uniform over all rotations, ``v = v_default + U`` [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_root_state_with_random_orientation``.
    """
    offset = random.uniform_vec3(env, rng, pose_range, 0)
    pos = wp.transform_get_translation(robot.default_root_pose[env]) + robot.env_origin[env] + offset
    robot.root_pose[env] = wp.transform(pos, random.random_quat(env, rng))
    robot.root_vel[env] = robot.default_root_vel[env] + random.uniform_twist(env, rng, velocity_range)


@resets("root")
@wp.func
def reset_root_to_default(env: int, robot: ArticulationData):
    """Reset the root to its default state: part of ``reset_scene_to_default``.

    Formula: ``p = p_default + origin`` [m], ``q = q_default``, ``v = v_default`` [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_scene_to_default``.
    """
    pose = robot.default_root_pose[env]
    pos = wp.transform_get_translation(pose) + robot.env_origin[env]
    robot.root_pose[env] = wp.transform(pos, wp.transform_get_rotation(pose))
    robot.root_vel[env] = robot.default_root_vel[env]


@resets("joints")
@wp.func
def reset_joints_to_default(env: int, robot: ArticulationData):
    """Reset all joints to their default state: part of ``reset_scene_to_default``.

    Formula: ``q = q_default`` [m or rad], ``qd = qd_default`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.reset_scene_to_default``.
    """
    for j in range(robot.joint_pos.shape[1]):
        robot.joint_pos[env, j] = robot.default_joint_pos[env, j]
    for j in range(robot.joint_vel.shape[1]):
        robot.joint_vel[env, j] = robot.default_joint_vel[env, j]


@wp.func
def reset_joint_targets_to_default(env: int, robot: ArticulationData):
    """Reset the targets of all joints to their default state: part of ``reset_scene_to_default``.

    Formula: ``q* = q_default`` [m or rad], ``qd* = qd_default`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.reset_scene_to_default``, there with ``reset_joint_targets``.
    """
    for j in range(robot.joint_pos_target.shape[1]):
        robot.joint_pos_target[env, j] = robot.default_joint_pos[env, j]
    for j in range(robot.joint_vel_target.shape[1]):
        robot.joint_vel_target[env, j] = robot.default_joint_vel[env, j]


@for_each_asset
@resets("root", "joints")
@wp.func
def reset_scene_to_default(env: int, robot: ArticulationData, reset_joint_targets: bool = True):
    """Reset root and joints to their default state; with ``reset_joint_targets`` the joint targets too.

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
    """Push the root by a random change of its velocity.

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
    """Apply a random force and torque to bodies, about their centres of mass, until the next change.

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
    """Advance an interval clock by a step; returns whether the interval is over. A clock at 0 draws an interval first.

    Formula: over after ``n = max(1, ceil(U(interval_range_s) / step_dt - 0.001))`` steps: the first multiple of
    ``step_dt`` that is not earlier, but for rounding.
    """
    left = steps_left[env]
    if left <= 0:
        time = random.uniform_range(env, rng, interval_range_s)
        # 0.001 of a step as a tolerance: 0.3 s must be 3 steps of 0.1 s, however float32 rounds the quotient. The bound
        # of 2e9 keeps an infinite interval within int32.
        left = wp.int32(wp.clamp(wp.ceil(time / step_dt - 1.0e-3), 1.0, 2.0e9))
    left = left - 1
    steps_left[env] = left
    return left == 0


@wp.func
def reset_is_due(env: int, step: wp.array[wp.int64], last_run: wp.array[wp.int64], min_steps: int) -> bool:
    """Whether a reset term is due: at its first reset, then ``min_steps`` steps after its last run; records the run.

    ``last_run`` holds ``step[0] + 1`` of the last run, 0 before the first.

    Formula: ``step[0] + 1 - last_run >= min_steps``.
    """
    now = step[0] + wp.int64(1)
    due = last_run[env] == wp.int64(0) or now - last_run[env] >= wp.int64(min_steps)
    if due:
        last_run[env] = now
    return due
