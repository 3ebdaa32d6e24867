# SPDX-License-Identifier: Apache-2.0
"""Terms of mjlab's flat velocity task that differ from this package's terms in a detail.

Velocities of links are those of points on them, as in mjlab, while ours are those of centres of mass. Source of all
formulas: mjlab 1.6, ``mdp`` of its velocity task.
"""

import warp as wp

from stripe_kernels.data import ArticulationData, VelocityCommandData
from stripe_kernels.mdp import frames, random
from stripe_kernels.mdp.commands import resample_uniform_velocity
from stripe_kernels.mdp.randomization import LOG_UNIFORM, sample
from stripe_kernels.model_data import BodyModelData, ShapeModelData
from stripe_kernels.sensors.contact import ContactSensorData, first_contact

__all__ = [
    "feet_clearance",
    "feet_slip",
    "feet_swing_height",
    "foot_height",
    "point_lin_vel",
    "randomize_feet",
    "resample_velocity",
    "track_angular_velocity",
    "track_linear_velocity",
    "upright",
    "variable_posture",
]

# -- points on links


@wp.func
def root_point_vel_b(env: int, robot: ArticulationData, model: BodyModelData, point: wp.vec3) -> wp.vec3:
    """Velocity of a point of the root, both in its frame: ``R^T v + w_b x (p - c)`` [m/s], ``c`` the centre of mass."""
    arm = point - model.com[env, 0]
    return frames.root_lin_vel_b(env, robot) + wp.cross(frames.root_ang_vel_b(env, robot), arm)


@wp.func
def point_speed_xy(env: int, robot: ArticulationData, model: BodyModelData, body: int, point: wp.vec3) -> float:
    """Horizontal speed of a point given in a body's frame: ``|(v + w x R (p - c)).xy|`` [m/s]."""
    vel = robot.body_vel[env, body]
    arm = wp.quat_rotate(wp.transform_get_rotation(robot.body_pose[env, body]), point - model.com[env, body])
    at = wp.spatial_top(vel) + wp.cross(wp.spatial_bottom(vel), arm)
    return wp.length(wp.vec2(at[0], at[1]))


@wp.func
def point_height(env: int, robot: ArticulationData, body: int, point: wp.vec3) -> float:
    """Height above the plane of a point given in a body's frame [m], as rays of 1 m measure it: within [0, 1]."""
    return wp.clamp(wp.transform_point(robot.body_pose[env, body], point)[2], 0.0, 1.0)


@wp.func
def is_moving(env: int, command: VelocityCommandData, threshold: float) -> float:
    """1 where ``|c.xy| + |c.yaw| > threshold``, else 0."""
    c = command.command[env]
    return wp.where(wp.length(wp.vec2(c[0], c[1])) + wp.abs(c[2]) > threshold, 1.0, 0.0)


@wp.func
def touches(env: int, sensor: ContactSensorData, body: int) -> bool:
    """Whether a body has a contact force."""
    return wp.length(sensor.net_forces_w[env, body]) > sensor.force_threshold


# -- observations


@wp.func
def point_lin_vel(env: int, robot: ArticulationData, model: BodyModelData, point: wp.vec3, out: wp.array[float]):
    """Velocity of a point of the root in its frame [m/s]."""
    vel = root_point_vel_b(env, robot, model, point)
    for k in range(3):
        out[k] = vel[k]


@wp.func
def foot_height(
    env: int, robot: ArticulationData, body_ids: wp.array[int], points: wp.array[wp.vec3], out: wp.array[float]
):
    """Heights of the feet [m]."""
    for i in range(body_ids.shape[0]):
        out[i] = point_height(env, robot, body_ids[i], points[i])


# -- rewards


@wp.func
def track_linear_velocity(
    env: int, robot: ArticulationData, model: BodyModelData, command: VelocityCommandData, std: float
) -> float:
    """``exp(-((c.x - v.x)^2 + (c.y - v.y)^2 + v.z^2) / std^2)``, ``v`` of the root link's origin, in its frame."""
    v = root_point_vel_b(env, robot, model, wp.vec3())
    error = wp.vec3(command.command[env, 0] - v[0], command.command[env, 1] - v[1], v[2])
    return wp.exp(-wp.length_sq(error) / (std * std))


@wp.func
def track_angular_velocity(env: int, robot: ArticulationData, command: VelocityCommandData, std: float) -> float:
    """``exp(-((c.yaw - w.z)^2 + w.x^2 + w.y^2) / std^2)``, ``w`` in the root's frame."""
    w = frames.root_ang_vel_b(env, robot)
    return wp.exp(-wp.length_sq(wp.vec3(w[0], w[1], command.command[env, 2] - w[2])) / (std * std))


@wp.func
def upright(env: int, robot: ArticulationData, std: float) -> float:
    """``exp(-(g.x^2 + g.y^2) / std^2)``, ``g`` the direction of gravity in the root's frame."""
    g = frames.projected_gravity_b(env, robot)
    return wp.exp(-(g[0] * g[0] + g[1] * g[1]) / (std * std))


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
    """``exp(-mean_i ((q_i - q_default,i) / std_i)^2)``, ``std`` by ``|c.xy| + |c.yaw|`` against the thresholds."""
    walks = is_moving(env, command, walking_threshold) > 0.0
    runs = is_moving(env, command, running_threshold) > 0.0
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        std = wp.where(runs, std_running[i], wp.where(walks, std_walking[i], std_standing[i]))
        error = (robot.joint_pos[env, joint_ids[i]] - robot.default_joint_pos[env, joint_ids[i]]) / std
        total += error * error
    return wp.exp(-total / float(joint_ids.shape[0]))


@wp.func
def feet_clearance(
    env: int,
    robot: ArticulationData,
    model: BodyModelData,
    command: VelocityCommandData,
    body_ids: wp.array[int],
    points: wp.array[wp.vec3],
    target_height: float,
    command_threshold: float,
) -> float:
    """``sum_i |z_i - target_height| |v_i.xy|`` where the command is to move."""
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        off = wp.abs(point_height(env, robot, body_ids[i], points[i]) - target_height)
        total += off * point_speed_xy(env, robot, model, body_ids[i], points[i])
    return total * is_moving(env, command, command_threshold)


@wp.func
def feet_swing_height(
    env: int,
    robot: ArticulationData,
    sensor: ContactSensorData,
    command: VelocityCommandData,
    sensor_body_ids: wp.array[int],
    body_ids: wp.array[int],
    points: wp.array[wp.vec3],
    peak: wp.array2d[float],
    target_height: float,
    step_dt: float,
    command_threshold: float,
) -> float:
    """``sum_i landed_i (peak_i / target_height - 1)^2`` where the command is to move; ``peak`` is the largest
    height in the air since the last landing, 0 if there was none."""
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        if not touches(env, sensor, sensor_body_ids[i]):
            peak[env, i] = wp.max(peak[env, i], point_height(env, robot, body_ids[i], points[i]))
        if first_contact(env, sensor, sensor_body_ids[i], step_dt):
            error = peak[env, i] / target_height - 1.0
            total += error * error
            peak[env, i] = 0.0
    return total * is_moving(env, command, command_threshold)


@wp.func
def feet_slip(
    env: int,
    robot: ArticulationData,
    model: BodyModelData,
    sensor: ContactSensorData,
    command: VelocityCommandData,
    sensor_body_ids: wp.array[int],
    body_ids: wp.array[int],
    points: wp.array[wp.vec3],
    command_threshold: float,
) -> float:
    """``sum_i touches_i |v_i.xy|^2`` where the command is to move."""
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        if touches(env, sensor, sensor_body_ids[i]):
            speed = point_speed_xy(env, robot, model, body_ids[i], points[i])
            total += speed * speed
    return total * is_moving(env, command, command_threshold)


# -- commands and events


@wp.func
def resample_velocity(
    env: int,
    command: VelocityCommandData,
    rng: wp.array[wp.uint32],
    lin_vel_x: wp.vec2,
    lin_vel_y: wp.vec2,
    ang_vel_z: wp.vec2,
    heading: wp.vec2,
    rel_heading_envs: float,
    rel_standing_envs: float,
    rel_forward_envs: float,
):
    """A uniform velocity command; the share ``rel_forward_envs`` is ``(max(|c.x|, 0.3), 0, 0)``."""
    resample_uniform_velocity(
        env, command, rng, lin_vel_x, lin_vel_y, ang_vel_z, heading, rel_heading_envs, rel_standing_envs
    )
    if random.bernoulli(env, rng, rel_forward_envs):
        command.command[env, 0] = wp.max(wp.abs(command.command[env, 0]), 0.3)
        command.command[env, 1] = 0.0
        command.command[env, 2] = 0.0


@wp.func
def randomize_feet(
    env: int,
    model: ShapeModelData,
    rng: wp.array[wp.uint32],
    shape_ids: wp.array[int],
    slide: wp.vec2,
    spin: wp.vec2,
    roll: wp.vec2,
):
    """Friction of all feet of a robot: sliding uniform, torsional and rolling log-uniform, one draw each."""
    sliding = random.uniform_range(env, rng, slide)
    torsional = sample(env, rng, spin, LOG_UNIFORM)
    rolling = sample(env, rng, roll, LOG_UNIFORM)
    for i in range(shape_ids.shape[0]):
        model.friction[env, shape_ids[i]] = sliding
        model.torsional_friction[env, shape_ids[i]] = torsional
        model.rolling_friction[env, shape_ids[i]] = rolling
