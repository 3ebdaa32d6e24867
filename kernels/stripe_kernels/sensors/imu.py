# SPDX-License-Identifier: Apache-2.0
"""IMU sensor (inertial measurement unit): pose, velocities and accelerations of a frame fixed to a body."""

import warp as wp

__all__ = ["ImuData", "measure_imu", "restart_imu"]


@wp.struct
class ImuData:
    """IMU data: pose, velocities and accelerations; ``_b`` means in the IMU's own frame; shape ``(num_envs,)`` each."""

    pos_w: wp.array[wp.vec3]
    """Origin of the frame in the world [m]."""
    quat_w: wp.array[wp.quat]
    """Orientation of the frame in the world, (x, y, z, w)."""
    lin_vel_b: wp.array[wp.vec3]
    """Velocity of the origin [m/s]."""
    ang_vel_b: wp.array[wp.vec3]
    """Angular velocity [rad/s]."""
    lin_acc_b: wp.array[wp.vec3]
    """Acceleration of the origin plus the gravity bias [m/s^2]; with the default bias an accelerometer's reading."""
    ang_acc_b: wp.array[wp.vec3]
    """Angular acceleration [rad/s^2]."""
    projected_gravity_b: wp.array[wp.vec3]
    """Direction of gravity, unit length."""


@wp.func
def _write_imu(
    env: int,
    body: int,
    mount: wp.transform,
    bias: wp.vec3,
    com: wp.vec3,
    gravity: wp.vec3,
    body_q: wp.array2d[wp.transform],
    vel: wp.spatial_vector,
    acc: wp.spatial_vector,
    imu: ImuData,
):
    """Write a measurement from the velocity and acceleration of the body's centre of mass, in the world."""
    pose = body_q[env, body]
    arm = wp.quat_rotate(wp.transform_get_rotation(pose), wp.transform_get_translation(mount) - com)
    frame = pose * mount
    q = wp.transform_get_rotation(frame)
    w = wp.spatial_bottom(vel)
    alpha = wp.spatial_bottom(acc)
    # Rigid-body kinematics: from the centre of mass to the origin of the IMU's frame.
    point_vel = wp.spatial_top(vel) + wp.cross(w, arm)
    point_acc = wp.spatial_top(acc) + wp.cross(alpha, arm) + wp.cross(w, wp.cross(w, arm))
    down = wp.vec3(0.0, 0.0, -1.0)  # in a world without gravity its direction is still defined
    if wp.length_sq(gravity) > 0.0:
        down = wp.normalize(gravity)
    imu.pos_w[env] = wp.transform_get_translation(frame)
    imu.quat_w[env] = q
    imu.lin_vel_b[env] = wp.quat_rotate_inv(q, point_vel)
    imu.ang_vel_b[env] = wp.quat_rotate_inv(q, w)
    imu.lin_acc_b[env] = wp.quat_rotate_inv(q, point_acc + bias)
    imu.ang_acc_b[env] = wp.quat_rotate_inv(q, alpha)
    imu.projected_gravity_b[env] = wp.quat_rotate_inv(q, down)


@wp.kernel(enable_backward=False)
def measure_imu(
    due: wp.array[wp.bool],
    body: int,
    mount: wp.transform,
    bias: wp.vec3,
    elapsed: wp.array[float],
    body_com: wp.array2d[wp.vec3],
    gravity: wp.array[wp.vec3],
    body_q: wp.array2d[wp.transform],
    body_qd: wp.array2d[wp.spatial_vector],
    previous: wp.array[wp.spatial_vector],
    imu: ImuData,
):
    """Measure; one thread an environment.

    Formula: ``a = (v - v_before) / h + alpha x r + w x (w x r)``, ``alpha = (w - w_before) / h``, ``v`` of the centre
    of mass, ``r`` from there to the frame, ``h`` the time since the velocities before were taken.

    Args:
        due: Environments that measure, shape ``(num_envs,)``; velocities are stored in all of them.
        body: Body that carries the frame.
        mount: Pose of the frame in the body's frame [m].
        bias: Gravity bias, added to the acceleration, in the world frame [m/s^2].
        elapsed: Time since the last call [s], shape ``(1,)``.
        body_com: Centres of mass in the bodies' frames [m], shape ``(num_envs, num_bodies)``.
        gravity: Gravity [m/s^2], shape ``(num_envs + 1,)``.
        body_q: Poses of the bodies [m], shape ``(num_envs, num_bodies)``.
        body_qd: Velocities of the centres of mass [m/s, rad/s], shape ``(num_envs, num_bodies)``.
        previous: Velocity of the body at the last call, updated [m/s, rad/s], shape ``(num_envs,)``.
        imu: Output, the measurement.
    """
    env = wp.tid()
    vel = body_qd[env, body]
    acc = (vel - previous[env]) / elapsed[0]
    previous[env] = vel  # also where no measurement is due, or ``elapsed`` would not be the time since then
    if due[env]:
        _write_imu(env, body, mount, bias, body_com[env, body], gravity[env], body_q, vel, acc, imu)


@wp.kernel(enable_backward=False)
def restart_imu(
    mask: wp.array[wp.bool],
    body: int,
    mount: wp.transform,
    bias: wp.vec3,
    body_com: wp.array2d[wp.vec3],
    gravity: wp.array[wp.vec3],
    body_q: wp.array2d[wp.transform],
    body_qd: wp.array2d[wp.spatial_vector],
    previous: wp.array[wp.spatial_vector],
    imu: ImuData,
):
    """Measure with zero acceleration where an episode starts; ``mask`` is the ``due`` of :func:`measure_imu`."""
    env = wp.tid()
    if not mask[env]:
        return
    # A difference to the velocity of the old episode would be no acceleration but a jump.
    vel = body_qd[env, body]
    previous[env] = vel
    still = wp.spatial_vector()
    _write_imu(env, body, mount, bias, body_com[env, body], gravity[env], body_q, vel, still, imu)
