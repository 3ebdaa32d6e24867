# SPDX-License-Identifier: Apache-2.0
"""Foot rewards: how feet are lifted, moved and put down; ``term(env, ...) -> float``, penalties are positive.

Sums run over the feet ``i``, the bodies of a contact sensor that ``sensor_cfg`` names. A foot has landed in a step if
its contact began in that step and still exists. ``F_i`` is the largest norm of its contact force in the sensor's
history, ``f_i`` the present force. Terms that read times need the sensor's ``track_air_time``. If a term reads an asset
too, ``asset_cfg`` names the same bodies among those of the asset, in the same order.
"""

import warp as wp

from ..data import ArticulationData, VelocityCommandData
from ..sensors.contact import ContactSensorData, first_air, first_contact, largest_force

__all__ = [
    "feet_air_time",
    "feet_air_time_positive_biped",
    "feet_clearance",
    "feet_slide",
    "feet_slip",
    "feet_swing_height",
    "soft_landing",
]


@wp.func
def _is_commanded_to_walk(env: int, command: VelocityCommandData, threshold: float) -> bool:
    """Whether the command is to walk: ``|c.xy| > threshold`` [m/s]."""
    return wp.length(wp.vec2(command.command[env, 0], command.command[env, 1])) > threshold


@wp.func
def _is_commanded_to_move(env: int, command: VelocityCommandData, threshold: float) -> bool:
    """Whether the command is to walk or to turn: ``|c.xy| + |c.yaw| > threshold``."""
    # The sum of a speed and a rate is mjlab's; thresholds of its configs are meant for it.
    c = command.command[env]
    return wp.length(wp.vec2(c[0], c[1])) + wp.abs(c[2]) > threshold


@wp.func
def _height(env: int, robot: ArticulationData, body: int) -> float:
    """Height of a body's frame above the origin of its environment [m]."""
    return wp.transform_get_translation(robot.body_pose[env, body])[2] - robot.env_origin[env][2]


@wp.func
def _speed_xy(env: int, robot: ArticulationData, body: int) -> float:
    """Horizontal speed of a body's centre of mass [m/s]."""
    vel = robot.body_vel[env, body]
    return wp.length(wp.vec2(vel[0], vel[1]))


@wp.func
def feet_air_time(
    env: int,
    sensor: ContactSensorData,
    command: VelocityCommandData,
    body_ids: wp.array[int],
    threshold: float,
    step_dt: float,
    command_threshold: float = 0.1,
) -> float:
    """Air time beyond a threshold of the feet that landed in this step, summed (a reward for long steps).

    Formula: ``sum_i landed_i (t_air,i - threshold)`` [s], ``0`` where ``|c.xy| <= command_threshold`` [m/s].

    Source: Isaac Lab, ``mdp.feet_air_time`` of its velocity task, there with a command threshold of 0.1.
    """
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        if first_contact(env, sensor, body_ids[i], step_dt):
            total += sensor.last_air_time[env, body_ids[i]] - threshold
    return wp.where(_is_commanded_to_walk(env, command, command_threshold), total, 0.0)


@wp.func
def feet_air_time_positive_biped(
    env: int,
    sensor: ContactSensorData,
    command: VelocityCommandData,
    body_ids: wp.array[int],
    threshold: float,
    command_threshold: float = 0.1,
) -> float:
    """Time that a robot has stood on one foot with all others in the air, up to a threshold.

    Formula: ``min(threshold, min_i t_i)`` [s] if one foot is in contact, else ``0``; ``t_i`` the time since the foot
    came into contact, or left it; ``0`` where ``|c.xy| <= command_threshold`` [m/s].

    Source: Isaac Lab, ``mdp.feet_air_time_positive_biped`` of its velocity task, there with a command threshold of 0.1.
    """
    standing = wp.int32(0)
    least = threshold
    for i in range(body_ids.shape[0]):
        time = sensor.current_contact_time[env, body_ids[i]]
        if time > 0.0:
            standing += 1
        else:
            time = sensor.current_air_time[env, body_ids[i]]
        least = wp.min(least, time)
    # Exactly one foot: neither standing on both nor hopping is rewarded.
    return wp.where(standing == 1 and _is_commanded_to_walk(env, command, command_threshold), least, 0.0)


@wp.func
def feet_slide(
    env: int,
    robot: ArticulationData,
    sensor: ContactSensorData,
    sensor_body_ids: wp.array[int],
    body_ids: wp.array[int],
    threshold: float = 1.0,
) -> float:
    """Speed of the feet that are in contact, summed (a slip penalty).

    Formula: ``sum_i (F_i > threshold) |v_i.xy|`` [m/s], ``v_i`` of the centre of mass, ``threshold`` [N].

    Source: Isaac Lab, ``mdp.feet_slide`` of its velocity task, there with a threshold of 1 N.
    """
    total = wp.float32(0.0)
    for i in range(sensor_body_ids.shape[0]):
        if largest_force(env, sensor, sensor_body_ids[i]) > threshold:
            total += _speed_xy(env, robot, body_ids[i])
    return total


@wp.func
def feet_slip(
    env: int,
    robot: ArticulationData,
    sensor: ContactSensorData,
    command: VelocityCommandData,
    sensor_body_ids: wp.array[int],
    body_ids: wp.array[int],
    command_threshold: float = 0.01,
) -> float:
    """Squared speed of the feet that are in contact, summed, while the command is to move (a slip penalty).

    Formula: ``sum_i (|f_i| > force_threshold) |v_i.xy|^2`` [m^2/s^2], ``v_i`` of the centre of mass,
    ``force_threshold`` of the sensor [N]; ``0`` where ``|c.xy| + |c.yaw| <= command_threshold``.

    Source: mjlab, ``mdp.feet_slip`` of its velocity task.
    """
    total = wp.float32(0.0)
    for i in range(sensor_body_ids.shape[0]):
        if wp.length(sensor.net_forces_w[env, sensor_body_ids[i]]) > sensor.force_threshold:
            speed = _speed_xy(env, robot, body_ids[i])
            total += speed * speed
    return wp.where(_is_commanded_to_move(env, command, command_threshold), total, 0.0)


@wp.func
def feet_clearance(
    env: int,
    robot: ArticulationData,
    command: VelocityCommandData,
    body_ids: wp.array[int],
    target_height: float,
    command_threshold: float = 0.01,
) -> float:
    """Error of the feet's height, weighted by their speed (a penalty); needs no sensor.

    Formula: ``sum_i |z_i - target_height| |v_i.xy|`` [m^2/s], ``z_i`` the height of the body's frame above the
    environment's origin [m]; ``0`` where ``|c.xy| + |c.yaw| <= command_threshold``.

    Source: mjlab, ``mdp.feet_clearance`` of its velocity task, there with heights above the terrain.
    """
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        total += wp.abs(_height(env, robot, body_ids[i]) - target_height) * _speed_xy(env, robot, body_ids[i])
    return wp.where(_is_commanded_to_move(env, command, command_threshold), total, 0.0)


@wp.func
def feet_swing_height(
    env: int,
    robot: ArticulationData,
    sensor: ContactSensorData,
    command: VelocityCommandData,
    sensor_body_ids: wp.array[int],
    body_ids: wp.array[int],
    peak: wp.array2d[float],
    target_height: float,
    step_dt: float,
    command_threshold: float = 0.05,
) -> float:
    """Relative error of the peak height of the feet that landed in this step, squared and summed (a penalty).

    Formula: ``sum_i landed_i (peak_i / target_height - 1)^2``, ``peak_i`` the largest height of the body's frame above
    the environment's origin [m] since the foot left the ground; ``0`` where ``|c.xy| + |c.yaw| <= command_threshold``.
    A foot that has not yet been in the air in its episode does not land. ``peak`` stores the heights between steps.

    Source: mjlab, ``mdp.feet_swing_height`` of its velocity task, there with heights above the terrain.
    """
    total = wp.float32(0.0)
    for i in range(sensor_body_ids.shape[0]):
        body = sensor_body_ids[i]
        height = _height(env, robot, body_ids[i])
        if sensor.current_contact_time[env, body] > 0.0:
            # A robot set down at a reset touches the ground for the first time without having taken a step.
            if sensor.last_air_time[env, body] > 0.0 and first_contact(env, sensor, body, step_dt):
                error = peak[env, i] / target_height - 1.0
                total += error * error
            peak[env, i] = height
        elif first_air(env, sensor, body, step_dt):  # a new swing: forget the peak of the last one
            peak[env, i] = height
        else:
            peak[env, i] = wp.max(peak[env, i], height)
    return wp.where(_is_commanded_to_move(env, command, command_threshold), total, 0.0)


@wp.func
def soft_landing(
    env: int,
    sensor: ContactSensorData,
    command: VelocityCommandData,
    body_ids: wp.array[int],
    step_dt: float,
    command_threshold: float = 0.05,
) -> float:
    """Contact force of the feet that landed in this step, summed (a penalty for hard landings).

    Formula: ``sum_i landed_i F_i`` [N], ``0`` where ``|c.xy| + |c.yaw| <= command_threshold``.

    Source: mjlab, ``mdp.soft_landing`` of its velocity task.
    """
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        if first_contact(env, sensor, body_ids[i], step_dt):
            total += largest_force(env, sensor, body_ids[i])
    return wp.where(_is_commanded_to_move(env, command, command_threshold), total, 0.0)
