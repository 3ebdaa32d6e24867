# SPDX-License-Identifier: Apache-2.0
"""Contact sensor: contact forces on bodies, and times in contact and in the air.

With the fused solver, which lists the contacts of each world, a measurement is one launch, ``measure_contacts``.

With others it is two: ``begin_contacts`` shifts the history and clears the sums, then one kernel adds the forces, a
thread a contact (``contact_mujoco.add_mujoco_contacts``, or ``add_newton_contacts`` for solvers other than MuJoCo
Warp). Times need the complete sums, so they are updated by the next ``begin_contacts``, or by ``finish_contacts`` at
the end of the step.
"""

import warp as wp

__all__ = [
    "ContactSensorData",
    "add_force",
    "add_newton_contacts",
    "begin_contacts",
    "finish_contacts",
    "first_air",
    "first_contact",
    "largest_force",
    "measure_contacts",
    "reset_contacts",
]


@wp.struct
class ContactSensorData:
    """Contact sensor data: forces on the bodies, in the world frame and friction included, and contact times."""

    net_forces_w: wp.array2d[wp.vec3]
    """Contact force on each body [N], shape ``(num_envs, num_bodies)``."""
    net_forces_w_history: wp.array3d[wp.vec3]
    """Last measurements of the contact forces, newest first [N], shape
    ``(num_envs, max(1, history_length), num_bodies)``."""
    force_matrix_w: wp.array3d[wp.vec3]
    """Contact force on each body from the bodies of each filter [N], shape ``(num_envs, num_bodies, num_filters)``."""
    current_air_time: wp.array2d[float]
    """Time in the air; 0 in contact [s], shape ``(num_envs, num_bodies)``."""
    last_air_time: wp.array2d[float]
    """Time in the air before the last contact [s], shape ``(num_envs, num_bodies)``."""
    current_contact_time: wp.array2d[float]
    """Time in contact; 0 in the air [s], shape ``(num_envs, num_bodies)``."""
    last_contact_time: wp.array2d[float]
    """Time in contact before the body last left it [s], shape ``(num_envs, num_bodies)``."""
    force_threshold: float
    """Force above which a body is in contact [N]."""
    measurement_dt: float
    """Time between two measurements [s]."""


@wp.func
def first_contact(env: int, sensor: ContactSensorData, body: int, dt: float) -> bool:
    """Whether a body came into contact in the last ``dt`` seconds and is still in contact.

    Formula: ``0 < t_contact < dt + h / 2``, ``h`` the time between two measurements.

    Source: Isaac Lab, ``ContactSensor.compute_first_contact``, there with a tolerance of 1e-8 s.
    """
    # Half a measurement as a tolerance: the time is a sum of float32 steps, which may end just above ``dt``.
    time = sensor.current_contact_time[env, body]
    return time > 0.0 and time < dt + 0.5 * sensor.measurement_dt


@wp.func
def first_air(env: int, sensor: ContactSensorData, body: int, dt: float) -> bool:
    """Whether a body lost contact in the last ``dt`` seconds and is still in the air.

    Formula: ``0 < t_air < dt + h / 2``, ``h`` the time between two measurements.

    Source: Isaac Lab, ``ContactSensor.compute_first_air``, there with a tolerance of 1e-8 s.
    """
    time = sensor.current_air_time[env, body]
    return time > 0.0 and time < dt + 0.5 * sensor.measurement_dt


@wp.func
def largest_force(env: int, sensor: ContactSensorData, body: int) -> float:
    """Norm of the largest contact force in the history of a body [N]."""
    largest = wp.float32(0.0)
    for k in range(sensor.net_forces_w_history.shape[1]):
        largest = wp.max(largest, wp.length(sensor.net_forces_w_history[env, k, body]))
    return largest


# -- a measurement


@wp.func
def _read_times(env: int, body: int, remainder: wp.array2d[float], sensor: ContactSensorData) -> wp.vec3:
    """Times in the air and in contact, and what rounding cut off their last sum [s]."""
    return wp.vec3(sensor.current_air_time[env, body], sensor.current_contact_time[env, body], remainder[env, body])


@wp.func
def _update_times(
    env: int,
    body: int,
    net: wp.vec3,
    times: wp.vec3,
    elapsed: float,
    remainder: wp.array2d[float],
    sensor: ContactSensorData,
):
    """Update the times in contact and in the air by the force of the last measurement, ``elapsed`` [s] long.

    ``times`` are those of :func:`_read_times`.

    Formula: compensated sums. A plain sum of float32 is 2 % wrong after hours, and stops growing after days. Here
    ``remainder`` keeps what rounding cut off the last sum, for the next one.

    Source: Kahan, "Further remarks on reducing truncation errors", 1965.
    """
    air, contact = times[0], times[1]
    touches = wp.length(net) > sensor.force_threshold
    time = wp.where(touches, contact, air)  # the one that goes on; the other ends if it was not 0
    step = wp.where(time > 0.0, elapsed + times[2], elapsed)
    longer = time + step
    remainder[env, body] = step - (longer - time)
    if touches:
        if air > 0.0:  # landed: as in Isaac Lab, the time in the air runs up to this measurement
            sensor.last_air_time[env, body] = air + elapsed
        sensor.current_air_time[env, body] = 0.0
        sensor.current_contact_time[env, body] = longer
    else:
        if contact > 0.0:
            sensor.last_contact_time[env, body] = contact + elapsed
        sensor.current_contact_time[env, body] = 0.0
        sensor.current_air_time[env, body] = longer


@wp.func
def _shift_history(env: int, body: int, sensor: ContactSensorData):
    """Shift the history of a body by one measurement, and clear its filtered forces."""
    count = sensor.net_forces_w_history.shape[1]
    for k in range(1, count):  # from the oldest entry on, so that none is overwritten before it is copied
        slot = count - k
        sensor.net_forces_w_history[env, slot, body] = sensor.net_forces_w_history[env, slot - 1, body]
    for k in range(sensor.force_matrix_w.shape[2]):
        sensor.force_matrix_w[env, body, k] = wp.vec3()


@wp.kernel(enable_backward=False)
def begin_contacts(
    due: wp.array[wp.bool],
    elapsed: wp.array[float],
    track_times: bool,
    pending: wp.array2d[wp.bool],
    remainder: wp.array2d[float],
    sensor: ContactSensorData,
):
    """Begin a measurement: update the times of the last one, shift the history, clear the sums.

    Threads are (environment, body).

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        elapsed: Time between two measurements [s], shape ``(1,)``.
        track_times: Whether times in contact and in the air are tracked.
        pending: Whether the times lack the last measurement, shape ``(num_envs, num_bodies)``.
        remainder: What the sums of the times lack [s], same shape.
        sensor: The sensor to write.
    """
    env, body = wp.tid()
    if not due[env]:
        return
    # First the times: they are computed from the sums that are cleared below.
    if pending[env, body]:
        times = _read_times(env, body, remainder, sensor)
        _update_times(env, body, sensor.net_forces_w[env, body], times, elapsed[0], remainder, sensor)
    pending[env, body] = track_times
    _shift_history(env, body, sensor)
    sensor.net_forces_w[env, body] = wp.vec3()


@wp.kernel(enable_backward=False)
def measure_contacts(
    due: wp.array[wp.bool],
    elapsed: wp.array[float],
    track_times: bool,
    geom_row: wp.array2d[int],
    geom_column: wp.array2d[int],
    contact_geoms: wp.array2d[wp.vec2i],
    contact_forces: wp.array2d[wp.vec3],
    remainder: wp.array2d[float],
    sensor: ContactSensorData,
):
    """Measure: shift the history, sum the forces of the contacts listed for each environment, update the times.

    Threads are (environment, body). Each goes over the contacts of its environment: there are few, they are the same
    for neighbouring threads, and sums in the order of the list are the same in every run.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        elapsed: Time between two measurements [s], shape ``(1,)``.
        track_times: Whether times in contact and in the air are tracked.
        geom_row: Index of each geom's body among the sensor's, else -1, shape ``(num_envs or 1, num_geoms)``.
        geom_column: Filter that each geom belongs to, else -1, same shape.
        contact_geoms: The two geoms, -1 in the first place without a contact, shape ``(num_envs, places)``.
        contact_forces: Forces on the second geom, in the world frame [N], shape ``(num_envs, places)``.
        remainder: What the sums of the times lack [s], shape ``(num_envs, num_bodies)``.
        sensor: The sensor to write.
    """
    env, body = wp.tid()
    if not due[env]:
        return
    # Read here, the times are there once the forces are summed: a load does not move ahead of a store by itself.
    times = _read_times(env, body, remainder, sensor)
    _shift_history(env, body, sensor)
    table = env % geom_row.shape[0]
    net = wp.vec3()
    for contact in range(contact_geoms.shape[1]):
        pair = contact_geoms[env, contact]
        if pair[0] < 0:
            break
        for side in range(2):
            if geom_row[table, pair[side]] == body:
                force = contact_forces[env, contact] * (2.0 * float(side) - 1.0)
                net += force
                column = geom_column[table, pair[1 - side]]
                if column >= 0:
                    sensor.force_matrix_w[env, body, column] += force
    sensor.net_forces_w[env, body] = net
    if track_times:
        _update_times(env, body, net, times, elapsed[0], remainder, sensor)


@wp.kernel(enable_backward=False)
def finish_contacts(
    elapsed: wp.array[float],
    pending: wp.array2d[wp.bool],
    remainder: wp.array2d[float],
    sensor: ContactSensorData,
):
    """Update the times by the last measurement of a step; threads (environment, body)."""
    env, body = wp.tid()
    if pending[env, body]:
        times = _read_times(env, body, remainder, sensor)
        _update_times(env, body, sensor.net_forces_w[env, body], times, elapsed[0], remainder, sensor)
        pending[env, body] = False


@wp.kernel(enable_backward=False)
def reset_contacts(mask: wp.array[wp.bool], pending: wp.array2d[wp.bool], sensor: ContactSensorData):
    """Clear forces and times in the environments of ``mask``; threads (environment, body)."""
    env, body = wp.tid()
    if not mask[env]:
        return
    pending[env, body] = False  # or the new episode would start with the contacts of the old one
    for k in range(sensor.net_forces_w_history.shape[1]):
        sensor.net_forces_w_history[env, k, body] = wp.vec3()
    for k in range(sensor.force_matrix_w.shape[2]):
        sensor.force_matrix_w[env, body, k] = wp.vec3()
    sensor.current_air_time[env, body] = 0.0
    sensor.last_air_time[env, body] = 0.0
    sensor.current_contact_time[env, body] = 0.0
    sensor.last_contact_time[env, body] = 0.0


# -- forces


@wp.func
def add_force(row: int, column: int, force: wp.vec3, sensor: ContactSensorData):
    """Add a contact force [N] to a body and, if ``column`` is not negative, to a filter of it.

    ``row`` is ``env * num_bodies + body``.
    """
    bodies = sensor.net_forces_w.shape[1]
    env = row // bodies
    body = row - env * bodies
    # Threads of several contacts add to one body, in any order: the last digits may differ from run to run.
    wp.atomic_add(sensor.net_forces_w, env, body, force)
    if column >= 0:
        wp.atomic_add(sensor.force_matrix_w, env, body, column, force)


@wp.kernel(enable_backward=False)
def add_newton_contacts(
    due: wp.array[wp.bool],
    contact_count: wp.array[int],
    contact_shape0: wp.array[int],
    contact_shape1: wp.array[int],
    contact_force: wp.array[wp.spatial_vector],
    shape_row: wp.array[int],
    shape_column: wp.array[int],
    sensor: ContactSensorData,
):
    """Add the forces of Newton's contacts; one thread a contact.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        contact_count: Number of contacts, shape ``(1,)``.
        contact_shape0: First shapes of the contacts.
        contact_shape1: Second shapes.
        contact_force: Wrenches on the first shapes, in the world frame [N, N m].
        shape_row: ``env * num_bodies + body`` of each shape of a sensing body, else -1; shape ``(shape_count,)``.
        shape_column: Filter that each shape belongs to, else -1; shape ``(shape_count,)``.
        sensor: The sensor to add to.
    """
    contact = wp.tid()
    if contact >= contact_count[0]:  # a graph launches a thread for every slot, used or not
        return
    shape0 = contact_shape0[contact]
    shape1 = contact_shape1[contact]
    if shape0 < 0 or shape1 < 0:
        return
    row0 = shape_row[shape0]
    row1 = shape_row[shape1]
    row = wp.max(row0, row1)
    if row < 0 or not due[row // sensor.net_forces_w.shape[1]]:
        return
    force = wp.spatial_top(contact_force[contact])
    if row0 >= 0:
        add_force(row0, shape_column[shape1], force, sensor)
    if row1 >= 0:
        add_force(row1, shape_column[shape0], -force, sensor)
