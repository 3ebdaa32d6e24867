# SPDX-License-Identifier: Apache-2.0
"""Actuators: joint targets become efforts before each physics step, in one launch for all joints and environments.

The laws are those of Newton's actuator library (``newton.actuators``): delay, then drive, then limits. Units are those
of the joint: N, m and s, or N m, rad and s.
"""

import newton
import warp as wp

from .mdp.random import uniform

__all__ = [
    "LAW_MADE",
    "LAW_PD",
    "LAW_PID",
    "LAW_SOLVER",
    "JointDrives",
    "ask_solver_joint",
    "dc_motor_range",
    "drive_explicit_joint",
    "drive_joints",
    "feed_solver_joint",
    "interpolate_table",
    "mask_gains",
    "reset_drives",
    "solver_drive",
    "solver_feed",
]

LAW_SOLVER = wp.constant(0)
"""The solver drives the joint itself, and integrates its gains implicitly."""
LAW_PD = wp.constant(1)
"""Position and velocity gain."""
LAW_PID = wp.constant(2)
"""Position, integral and velocity gain."""
LAW_MADE = wp.constant(3)
"""The effort was computed by Newton's own actuator, a network for example; it is only limited here."""

_POSITION = wp.constant(int(newton.JointTargetMode.POSITION))
_VELOCITY = wp.constant(int(newton.JointTargetMode.VELOCITY))
_BOTH = wp.constant(int(newton.JointTargetMode.POSITION_VELOCITY))


@wp.struct
class JointDrives:
    """State, targets, gains and limits of all joints. Arrays of shape ``(dofs,)`` hold for all environments."""

    dt: float
    """Time step of the physics [s]."""
    feeds_velocity: bool
    """Whether the solver's position drives ignore velocity targets, so that ``kd qd*`` is added as an effort."""
    masks_gains: bool
    """Whether the gains of explicit actuators must be hidden from the solver, which would apply them again."""
    coord: wp.array[int]
    """Coordinate of each degree of freedom, -1 where it has none of its own, shape ``(dofs,)``."""
    law: wp.array[int]
    """Law of each joint, one of the ``LAW`` constants, shape ``(dofs,)``."""
    mode: wp.array2d[int]
    """Kind of target that the solver's drive follows, ``newton.JointTargetMode``, shape ``(num_envs, dofs)``."""
    joint_pos: wp.array2d[float]
    """Positions, shape ``(num_envs, coords)``."""
    joint_vel: wp.array2d[float]
    """Velocities, shape ``(num_envs, dofs)``."""
    pos_target: wp.array2d[float]
    """Position targets, shape ``(num_envs, coords)``."""
    vel_target: wp.array2d[float]
    """Velocity targets, shape ``(num_envs, dofs)``."""
    effort_target: wp.array2d[float]
    """Effort targets, shape ``(num_envs, dofs)``."""
    stiffness: wp.array2d[float]
    """Position gains, of the solver's drive or the explicit one, shape ``(num_envs, dofs)``."""
    damping: wp.array2d[float]
    """Velocity gains, of the solver's drive or the explicit one, shape ``(num_envs, dofs)``."""
    effort_limit: wp.array2d[float]
    """Largest efforts, shape ``(num_envs, dofs)``."""
    integral_gain: wp.array2d[float]
    """Gains of the integrated position error, shape ``(num_envs, dofs)``."""
    integral_limit: wp.array2d[float]
    """Largest integrated position error [m s or rad s], shape ``(num_envs, dofs)``."""
    integral: wp.array2d[float]
    """Integrated position error [m s or rad s], shape ``(num_envs, dofs)``."""
    bias_effort: wp.array2d[float]
    """Constant effort added to the law's, shape ``(num_envs, dofs)``."""
    made_effort: wp.array2d[float]
    """Effort that Newton's own actuators computed, cleared once read, shape ``(num_envs, dofs)``."""
    has_curve: wp.array[wp.bool]
    """Whether the effort is limited by a torque-speed curve, shape ``(dofs,)``."""
    saturation_effort: wp.array2d[float]
    """Effort of the motor at standstill, shape ``(num_envs, dofs)``."""
    no_load_speed: wp.array2d[float]
    """Speed at which the motor has no effort left, shape ``(num_envs, dofs)``."""
    table_start: wp.array[int]
    """First entry of the table of effort limits over the position, shape ``(dofs,)``."""
    table_count: wp.array[int]
    """Number of entries of that table, 0 for none, shape ``(dofs,)``."""
    table_pos: wp.array[float]
    """Positions of the tables, rising within each."""
    table_effort: wp.array[float]
    """Effort limits of the tables."""
    delay_slot: wp.array[int]
    """Column of delayed targets, -1 for none, shape ``(dofs,)``."""
    lag: wp.array2d[int]
    """Delay of the targets in physics steps, shape ``(num_envs, slots)``."""
    pushes: wp.array2d[int]
    """Targets stored since the episode began, shape ``(num_envs, slots)``; once the history is full the count stays
    between ``depth`` and ``2 depth``, the same modulo ``depth``."""
    history: wp.array3d[wp.vec3]
    """Past position, velocity and effort targets, shape ``(depth, num_envs, slots)``."""
    effort: wp.array2d[float]
    """Output: generalised force in addition to the solver's drives, shape ``(num_envs, dofs)``."""
    computed_effort: wp.array2d[float]
    """Output: efforts of the laws before any limit, shape ``(num_envs, dofs)``."""
    solver_stiffness: wp.array2d[float]
    """Output where ``masks_gains``: position gains of the solver's drives alone, shape ``(num_envs, dofs)``."""
    solver_damping: wp.array2d[float]
    """Output where ``masks_gains``: velocity gains of the solver's drives alone, shape ``(num_envs, dofs)``."""


@wp.func
def dc_motor_range(vel: float, saturation: float, no_load_speed: float, limit: float) -> wp.vec2:
    """Least and largest effort of a DC motor at a velocity: its torque-speed curve.

    Formula: ``[max(s (-1 - v/v0), -limit), min(s (1 - v/v0), limit)]``, ``s`` the effort at standstill, ``v0`` the
    no-load speed, ``v`` clamped to ``+-v0 (1 + limit/s)``, where the curve meets the limit.

    Source: ``newton.actuators.ClampingDCMotor``, as Isaac Lab's ``DCMotor``.
    """
    corner = no_load_speed
    if saturation > 0.0:
        ratio = limit / saturation
        if not wp.isnan(ratio):  # infinite effort and infinite limit: the curve has no corner
            corner = no_load_speed * (1.0 + ratio)
    v = wp.clamp(vel, -corner, corner)
    top = wp.min(saturation * (1.0 - v / no_load_speed), limit)
    bottom = wp.max(saturation * (-1.0 - v / no_load_speed), -limit)
    return wp.vec2(bottom, top)


@wp.func
def interpolate_table(x: float, xs: wp.array[float], ys: wp.array[float], start: int, count: int) -> float:
    """Linear interpolation in the entries ``start`` to ``start + count`` of a table, constant beyond its ends."""
    last = start + count - 1
    if x <= xs[start]:
        return ys[start]
    if x >= xs[last]:
        return ys[last]
    k = start
    while xs[k + 1] < x:
        k += 1
    return ys[k] + (x - xs[k]) / (xs[k + 1] - xs[k]) * (ys[k + 1] - ys[k])


@wp.func
def delayed_targets(env: int, slot: int, now: wp.vec3, drives: JointDrives) -> wp.vec3:
    """The targets of ``lag`` steps ago, or the oldest of a younger episode; stores ``now`` in the history."""
    depth = drives.history.shape[0]
    n = drives.pushes[env, slot]
    lag = wp.min(drives.lag[env, slot], n)
    late = now
    # Read before the write: at a lag of ``depth`` both use the same entry of the ring.
    if lag > 0:
        late = drives.history[(n - lag) % depth, env, slot]
    drives.history[n % depth, env, slot] = now
    n += 1
    # Subtracting a whole ring keeps n % depth and never lets n fall below depth, so no lag is cut short again, and
    # the counter cannot overflow in an episode of any length.
    if n >= 2 * depth:
        n -= depth
    drives.pushes[env, slot] = n
    return late


@wp.func
def clamp_number(value: float, low: float, high: float) -> float:
    """``value`` limited to bounds. A NaN stays a NaN: a bound in its place would hide where it came from."""
    if wp.isnan(value):
        return value
    return wp.clamp(value, low, high)


@wp.func
def drive_explicit_joint(env: int, dof: int, pos: float, vel: float, drives: JointDrives) -> float:
    """Effort of a joint's explicit actuator, in the state given; it is also written to ``drives.effort``.

    ``effort = clamp(kp (q* - q) + ki I + kd (qd* - qd) + effort* + bias)`` within the torque-speed curve, the limit and
    the table, with delayed targets, and ``I <- clamp(I + dt (q* - q), +-integral_limit)``. What the actuator remembers
    advances by a physics step. A joint that the solver drives keeps the effort it has. The fused solver's kernel calls
    this function, too.

    Args:
        env: The environment.
        dof: Degree of freedom of the joint, within the environment.
        pos: Its position [m or rad].
        vel: Its velocity [m/s or rad/s].
        drives: State, targets, gains and limits.
    """
    law = drives.law[dof]
    if law == LAW_SOLVER:
        return drives.effort[env, dof]
    coord = drives.coord[dof]
    limit = drives.effort_limit[env, dof]
    targets = wp.vec3(0.0, drives.vel_target[env, dof], drives.effort_target[env, dof])
    if coord >= 0:
        targets[0] = drives.pos_target[env, coord]
    slot = drives.delay_slot[dof]
    if slot >= 0:
        targets = delayed_targets(env, slot, targets, drives)
    computed = wp.float32(0.0)
    if law == LAW_MADE:
        # Newton's actuators add to this array, so it must be 0 when they run before the next physics step.
        computed = drives.made_effort[env, dof]
        drives.made_effort[env, dof] = 0.0
    else:
        # The sum is taken in the order of Newton's DrivePID: another order would round differently.
        computed = drives.bias_effort[env, dof] + targets[2] + drives.stiffness[env, dof] * (targets[0] - pos)
        if law == LAW_PID:
            bound = drives.integral_limit[env, dof]
            integral = wp.clamp(drives.integral[env, dof] + (targets[0] - pos) * drives.dt, -bound, bound)
            drives.integral[env, dof] = integral
            computed += drives.integral_gain[env, dof] * integral
        computed += drives.damping[env, dof] * (targets[1] - vel)
    drives.computed_effort[env, dof] = computed
    applied = computed
    if drives.has_curve[dof]:
        bounds = dc_motor_range(vel, drives.saturation_effort[env, dof], drives.no_load_speed[env, dof], limit)
        applied = clamp_number(applied, bounds[0], bounds[1])
    applied = clamp_number(applied, -limit, limit)
    count = drives.table_count[dof]
    if count > 0:
        most = interpolate_table(pos, drives.table_pos, drives.table_effort, drives.table_start[dof], count)
        applied = clamp_number(applied, -most, most)
    drives.effort[env, dof] = applied
    return applied


@wp.func
def solver_feed(feeds_velocity: bool, mode: int, kd: float, speed: float, effort: float, limit: float) -> float:
    """Effort beside the solver's own drive, from numbers: see :func:`feed_solver_joint`."""
    fed = wp.float32(0.0)
    if feeds_velocity and mode == _POSITION:
        fed = kd * speed
    return clamp_number(effort + fed, -limit, limit)


@wp.func
def solver_drive(
    mode: int, kp: float, kd: float, target: float, speed: float, effort: float, pos: float, vel: float
) -> float:
    """Effort that the solver's drive asks for, from numbers: see :func:`ask_solver_joint`."""
    stiffness = kp
    damping = kd
    if mode != _POSITION and mode != _BOTH:
        stiffness = wp.float32(0.0)
        if mode != _VELOCITY:
            damping = wp.float32(0.0)
    return stiffness * (target - pos) + damping * (speed - vel) + effort


@wp.func
def feed_solver_joint(env: int, dof: int, drives: JointDrives) -> float:
    """Effort on a joint beside that of the solver's own drive; that of an explicit actuator stays as it is.

    ``effort = clamp(effort* + fed, +-limit)``, ``fed = kd qd*`` for a drive that follows a position alone. The fused
    solver's kernel calls this function, too.

    Args:
        env: The environment.
        dof: Degree of freedom of the joint, within the environment.
        drives: Targets, gains and limits.
    """
    if drives.law[dof] != LAW_SOLVER:
        return drives.effort[env, dof]
    kd = wp.float32(0.0)
    speed = wp.float32(0.0)
    mode = wp.int32(0)
    if drives.feeds_velocity:
        kd = drives.damping[env, dof]
        speed = drives.vel_target[env, dof]
        mode = drives.mode[env, dof]
    limit = drives.effort_limit[env, dof]
    return solver_feed(drives.feeds_velocity, mode, kd, speed, drives.effort_target[env, dof], limit)


@wp.func
def ask_solver_joint(env: int, dof: int, pos: float, vel: float, drives: JointDrives) -> float:
    """Effort that the solver's drive of a joint asks for, unlimited; that of an explicit actuator stays as it is.

    ``kp (q* - q) + kd (qd* - qd) + effort*`` with the gains of the drive's mode alone. The fused solver's kernel calls
    this function, too.

    Args:
        env: The environment.
        dof: Degree of freedom of the joint, within the environment.
        pos: Its position [m or rad].
        vel: Its velocity [m/s or rad/s].
        drives: Targets and gains.
    """
    if drives.law[dof] != LAW_SOLVER:
        return drives.computed_effort[env, dof]
    coord = drives.coord[dof]
    target = wp.float32(0.0)
    if coord >= 0:
        target = drives.pos_target[env, coord]
    kp = drives.stiffness[env, dof]
    kd = drives.damping[env, dof]
    speed = drives.vel_target[env, dof]
    return solver_drive(drives.mode[env, dof], kp, kd, target, speed, drives.effort_target[env, dof], pos, vel)


@wp.kernel(enable_backward=False)
def drive_joints(drives: JointDrives):
    """Compute the efforts of all joints; a thread for each degree of freedom of each environment.

    Joints driven by the solver: :func:`feed_solver_joint` and :func:`ask_solver_joint`. Joints with an explicit
    actuator: :func:`drive_explicit_joint`.

    Args:
        drives: State, targets, gains and limits.
    """
    env, dof = wp.tid()
    coord = drives.coord[dof]
    pos = wp.float32(0.0)
    if coord >= 0:
        pos = drives.joint_pos[env, coord]
    vel = drives.joint_vel[env, dof]
    if drives.law[dof] != LAW_SOLVER:
        drive_explicit_joint(env, dof, pos, vel, drives)
        return
    # Copied in every step, since a randomising event may have changed the gains. Entries of explicit actuators
    # are never written and stay 0: the solver must not apply their gains a second time.
    if drives.masks_gains:
        drives.solver_stiffness[env, dof] = drives.stiffness[env, dof]
        drives.solver_damping[env, dof] = drives.damping[env, dof]
    drives.computed_effort[env, dof] = ask_solver_joint(env, dof, pos, vel, drives)
    drives.effort[env, dof] = feed_solver_joint(env, dof, drives)


@wp.kernel(enable_backward=False)
def mask_gains(drives: JointDrives):
    """Write the gains of the solver's own drives, as :func:`drive_joints` does; a thread for each degree of freedom."""
    env, dof = wp.tid()
    if drives.law[dof] == LAW_SOLVER:
        drives.solver_stiffness[env, dof] = drives.stiffness[env, dof]
        drives.solver_damping[env, dof] = drives.damping[env, dof]


@wp.kernel(enable_backward=False)
def reset_drives(
    mask: wp.array[wp.bool],
    group: wp.array[int],
    low: wp.array[int],
    high: wp.array[int],
    rng: wp.array[wp.uint32],
    drives: JointDrives,
):
    """Reset drives where an episode starts: integrated errors, delayed targets, lags; a thread for each environment.

    Args:
        mask: Environments that start an episode, shape ``(num_envs,)``.
        group: Group of columns of delayed targets that share one drawn lag, -1 for a fixed lag, shape ``(slots,)``.
        low: Least lag of each group, shape ``(groups,)``.
        high: Largest lag of each group, shape ``(groups,)``.
        rng: Random streams, shape ``(num_envs,)``; one draw for each group.
        drives: The drives to reset.
    """
    env = wp.tid()
    if not mask[env]:
        return
    for dof in range(drives.integral.shape[1]):
        drives.integral[env, dof] = 0.0
    for slot in range(group.shape[0]):
        drives.pushes[env, slot] = 0
    # A history needs no clearing: with ``pushes`` at 0 no lag reaches back beyond the start of the episode.
    for g in range(low.shape[0]):
        lag = low[g] + wp.int32(uniform(env, rng) * wp.float32(high[g] - low[g] + 1))
        for slot in range(group.shape[0]):
            if group[slot] == g:
                drives.lag[env, slot] = wp.min(lag, high[g])
