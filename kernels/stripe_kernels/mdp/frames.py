# SPDX-License-Identifier: Apache-2.0
"""Frames: angles, rotations and body-frame quantities that terms call.

Quaternions are (x, y, z, w), of unit length. Linear velocities are those of the centre of mass.
"""

import warp as wp

from ..data import ArticulationData

__all__ = [
    "effort_excess",
    "euler_xyz",
    "heading_w",
    "projected_gravity_b",
    "quat_error",
    "quat_error_magnitude",
    "quat_unique",
    "root_ang_vel_b",
    "root_lin_vel_b",
    "rotate_inverse_yaw",
    "soft_joint_pos_limits",
    "wrap_to_pi",
    "yaw_of",
    "yaw_quat",
]


@wp.func
def wrap_to_pi(angle: float) -> float:
    """Wrap an angle [rad] to (-pi, pi]."""
    # An angle in that range is returned as it is: the formula below would change its last digits.
    if angle > -wp.pi and angle <= wp.pi:
        return angle
    return angle - 2.0 * wp.pi * wp.ceil((angle - wp.pi) / (2.0 * wp.pi))


@wp.func
def quat_unique(q: wp.quat) -> wp.quat:
    """Unique quaternion of a rotation: the one of ``q`` and ``-q`` with ``w >= 0``."""
    if q[3] < 0.0:
        return -q
    return q


@wp.func
def yaw_of(q: wp.quat) -> float:
    """Yaw [rad], in [-pi, pi]: angle of the rotated x axis in the horizontal plane; 0 where that axis is vertical."""
    return wp.atan2(2.0 * (q[3] * q[2] + q[0] * q[1]), 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]))


@wp.func
def yaw_quat(q: wp.quat) -> wp.quat:
    """Yaw of a rotation as a quaternion: the part of the rotation about the vertical."""
    half = 0.5 * yaw_of(q)
    return wp.quat(0.0, 0.0, wp.sin(half), wp.cos(half))


@wp.func
def rotate_inverse_yaw(q: wp.quat, v: wp.vec3) -> wp.vec3:
    """Rotate a vector from the world to the upright frame with the yaw of ``q``."""
    yaw = yaw_of(q)
    c = wp.cos(yaw)
    s = wp.sin(yaw)
    return wp.vec3(c * v[0] + s * v[1], c * v[1] - s * v[0], v[2])


@wp.func
def euler_xyz(q: wp.quat) -> wp.vec3:
    """Euler angles roll, pitch and yaw [rad] with ``R = Rz(yaw) Ry(pitch) Rx(roll)``, the inverse of ``wp.quat_rpy``.

    Roll and yaw are in (-pi, pi], pitch is in [-pi/2, pi/2]. At a pitch of +-pi/2 only yaw - roll or yaw + roll is
    defined; the three angles returned then still give the same rotation.
    """
    # Sum and difference of roll and yaw are each given by two components: no division, and no loss of digits near the
    # singularity.
    a = q[0] + q[2]
    b = q[3] - q[1]
    c = q[2] - q[0]
    d = q[3] + q[1]
    total = wp.atan2(a, b)  # (yaw + roll) / 2
    difference = wp.atan2(c, d)  # (yaw - roll) / 2
    pitch = 2.0 * wp.atan2(wp.sqrt(c * c + d * d), wp.sqrt(a * a + b * b)) - 0.5 * wp.pi
    return wp.vec3(wrap_to_pi(total - difference), pitch, wrap_to_pi(total + difference))


@wp.func
def quat_error(current: wp.quat, desired: wp.quat) -> wp.vec3:
    """Rotation vector [rad], axis times angle in [0, pi], that turns ``current`` into ``desired``, in the world."""
    q = quat_unique(desired * wp.quat_inverse(current))
    v = wp.vec3(q[0], q[1], q[2])
    sine = wp.length(v)
    if sine < 1.0e-6:  # the limit of the quotient below, which would be 0 / 0
        return 2.0 * v
    return v * (2.0 * wp.atan2(sine, q[3]) / sine)


@wp.func
def quat_error_magnitude(current: wp.quat, desired: wp.quat) -> float:
    """Angle between two orientations [rad], in [0, pi]."""
    return wp.length(quat_error(current, desired))


@wp.func
def root_lin_vel_b(env: int, robot: ArticulationData) -> wp.vec3:
    """Linear velocity of the root's centre of mass in the root's frame [m/s]."""
    q = wp.transform_get_rotation(robot.root_pose[env])
    return wp.quat_rotate_inv(q, wp.spatial_top(robot.root_vel[env]))


@wp.func
def root_ang_vel_b(env: int, robot: ArticulationData) -> wp.vec3:
    """Angular velocity of the root in the root's frame [rad/s]."""
    q = wp.transform_get_rotation(robot.root_pose[env])
    return wp.quat_rotate_inv(q, wp.spatial_bottom(robot.root_vel[env]))


@wp.func
def projected_gravity_b(env: int, robot: ArticulationData) -> wp.vec3:
    """Direction of gravity in the root's frame, unit length; (0, 0, -1) when upright."""
    return wp.quat_rotate_inv(wp.transform_get_rotation(robot.root_pose[env]), robot.gravity_dir)


@wp.func
def heading_w(env: int, robot: ArticulationData) -> float:
    """Angle of the root's x axis in the horizontal plane [rad], in [-pi, pi]."""
    return yaw_of(wp.transform_get_rotation(robot.root_pose[env]))


@wp.func
def soft_joint_pos_limits(env: int, robot: ArticulationData, joint: int) -> wp.vec2:
    """Lower and upper soft limit of a joint [m or rad]: the limits narrowed about their middle."""
    lower = robot.joint_pos_lower[env, joint]
    upper = robot.joint_pos_upper[env, joint]
    middle = 0.5 * (lower + upper)
    half = 0.5 * robot.soft_limit_factor * (upper - lower)
    return wp.vec2(middle - half, middle + half)


@wp.func
def effort_excess(env: int, robot: ArticulationData, joint: int) -> wp.vec2:
    """Excess of a drive's computed effort over its limit, and the limited effort [N or N m].

    Formula: ``(|tau - t|, t)``, ``tau = kp (q* - q) + kd (qd* - qd) + tau*`` at the present state,
    ``t = clamp(tau, -limit, limit)``.
    """
    law = robot.joint_stiffness[env, joint] * (robot.joint_pos_target[env, joint] - robot.joint_pos[env, joint])
    law += robot.joint_damping[env, joint] * (robot.joint_vel_target[env, joint] - robot.joint_vel[env, joint])
    law += robot.joint_effort_target[env, joint]
    limit = robot.joint_effort_limit[env, joint]
    limited = wp.clamp(law, -limit, limit)
    return wp.vec2(wp.abs(law - limited), limited)
