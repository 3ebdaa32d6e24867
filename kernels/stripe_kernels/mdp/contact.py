# SPDX-License-Identifier: Apache-2.0
"""Contact terms: rewards ``-> float``, a termination ``-> bool``, and observations that write to ``out``.

Sums run over the bodies ``i`` of a contact sensor that ``sensor_cfg`` names. ``F_i`` is the largest norm of a body's
contact force in the sensor's history, ``f_i`` the present force, in the world frame. Rewards for feet are in ``feet``.
"""

from typing import TYPE_CHECKING

import warp as wp

from ..removed_tables import forward_tables
from ..sensors.contact import ContactSensorData, largest_force
from ..term_info import Each, writes

__all__ = [
    "contact_forces",
    "desired_contacts",
    "feet_contact",
    "feet_contact_forces",
    "feet_current_air_time",
    "illegal_contact",
    "undesired_contacts",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, sizes={"CONTACT_OBSERVATION_SIZES": __name__})


# -- rewards


@wp.func
def undesired_contacts(env: int, sensor: ContactSensorData, body_ids: wp.array[int], threshold: float) -> float:
    """Number of bodies in contact (a penalty for contacts of the thighs, for example).

    Formula: ``sum_i (F_i > threshold)``, ``threshold`` [N].

    Source: Isaac Lab, ``mdp.undesired_contacts``.
    """
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        if largest_force(env, sensor, body_ids[i]) > threshold:
            total += 1.0
    return total


@wp.func
def desired_contacts(env: int, sensor: ContactSensorData, body_ids: wp.array[int], threshold: float = 1.0) -> float:
    """Penalty of 1 while none of the bodies is in contact.

    Formula: ``1`` if ``F_i <= threshold`` for all ``i``, else ``0``; ``threshold`` [N].

    Source: Isaac Lab, ``mdp.desired_contacts``.
    """
    for i in range(body_ids.shape[0]):
        if largest_force(env, sensor, body_ids[i]) > threshold:
            return 0.0
    return 1.0


@wp.func
def contact_forces(env: int, sensor: ContactSensorData, body_ids: wp.array[int], threshold: float) -> float:
    """Excess of the contact forces over a threshold, summed (a penalty).

    Formula: ``sum_i max(F_i - threshold, 0)`` [N].

    Source: Isaac Lab, ``mdp.contact_forces``.
    """
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        total += wp.max(largest_force(env, sensor, body_ids[i]) - threshold, 0.0)
    return total


# -- termination


@wp.func
def illegal_contact(env: int, sensor: ContactSensorData, body_ids: wp.array[int], threshold: float) -> bool:
    """Termination if one of the bodies is in contact.

    Formula: ``max_i F_i > threshold``, ``threshold`` [N].

    Source: Isaac Lab, ``mdp.illegal_contact``.
    """
    touches = wp.bool(False)
    for i in range(body_ids.shape[0]):
        touches = touches or largest_force(env, sensor, body_ids[i]) > threshold
    return touches


# -- observations


@writes(Each("body_ids"))
@wp.func
def feet_contact(env: int, sensor: ContactSensorData, body_ids: wp.array[int], out: wp.array[float]):
    """Contact flag of each body, one number a body.

    Formula: ``1`` if ``|f_i| > force_threshold`` of the sensor, else ``0``.

    Source: mjlab, ``mdp.foot_contact`` of its velocity task.
    """
    for i in range(body_ids.shape[0]):
        force = wp.length(sensor.net_forces_w[env, body_ids[i]])
        out[i] = wp.where(force > sensor.force_threshold, 1.0, 0.0)


@writes(Each("body_ids"))
@wp.func
def feet_current_air_time(env: int, sensor: ContactSensorData, body_ids: wp.array[int], out: wp.array[float]):
    """Time in the air of each body, 0 in contact, one number a body.

    Formula: ``t_air,i`` [s].

    Source: mjlab, ``mdp.foot_air_time`` of its velocity task.
    """
    for i in range(body_ids.shape[0]):
        out[i] = sensor.current_air_time[env, body_ids[i]]


@writes(Each("body_ids", 3))
@wp.func
def feet_contact_forces(env: int, sensor: ContactSensorData, body_ids: wp.array[int], out: wp.array[float]):
    """Contact forces on a logarithmic scale, in the world frame, three numbers a body.

    Formula: ``sign(f_ik) ln(1 + |f_ik|)``, ``f`` [N].

    Source: mjlab, ``mdp.foot_contact_forces`` of its velocity task.
    """
    for i in range(body_ids.shape[0]):
        force = sensor.net_forces_w[env, body_ids[i]]
        for k in range(3):
            out[3 * i + k] = wp.sign(force[k]) * wp.log(1.0 + wp.abs(force[k]))
