# SPDX-License-Identifier: Apache-2.0
"""Contact sensor for MuJoCo Warp: contact forces read from its contacts and constraints."""

import warp as wp
from mujoco_warp._src.support import contact_force_fn
from mujoco_warp._src.types import vec5

from .contact import ContactSensorData, add_force

__all__ = ["CONTACT_FIELDS", "add_mujoco_contacts"]

CONTACT_FIELDS = ("frame", "friction", "dim", "efc_address", "adhesion", "geom", "worldid")
"""Fields of MuJoCo Warp's contacts that the kernel takes, in the order of its arguments."""


@wp.kernel(enable_backward=False)
def add_mujoco_contacts(
    due: wp.array[wp.bool],
    geom_row: wp.array2d[int],
    geom_column: wp.array2d[int],
    cone: int,
    contact_frame: wp.array[wp.mat33],
    contact_friction: wp.array[vec5],
    contact_dim: wp.array[int],
    contact_efc_address: wp.array2d[int],
    contact_adhesion: wp.array[float],
    contact_geom: wp.array[wp.vec2i],
    contact_worldid: wp.array[int],
    efc_force: wp.array2d[float],
    njmax: int,
    nacon: wp.array[int],
    sensor: ContactSensorData,
):
    """Add the forces of MuJoCo Warp's contacts; a thread for each place of a contact, which may be empty.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        geom_row: Index of each geom's body among the sensor's, else -1, shape ``(num_envs or 1, num_geoms)``.
        geom_column: Filter that each geom belongs to, else -1, same shape.
        cone: MuJoCo's type of friction cone.
        contact_frame: Contact frames; the normal points from the first geom to the second.
        contact_friction: Friction coefficients.
        contact_dim: Dimension of each contact's force: 1, 3, 4 or 6.
        contact_efc_address: Rows of the constraints, -1 for none.
        contact_adhesion: Adhesive force, not in the constraints [N].
        contact_geom: The two geoms.
        contact_worldid: World, which is the environment.
        efc_force: Constraint forces, shape ``(num_envs, njmax)``.
        njmax: Capacity for constraints of a world.
        nacon: Number of contacts in all worlds, shape ``(1,)``.
        sensor: The sensor to add to.
    """
    contact = wp.tid()
    # A contact without a row of constraints lies within the gap and carries no force.
    if contact >= nacon[0] or contact_efc_address[contact, 0] < 0:
        return
    pair = contact_geom[contact]
    if pair[0] < 0 or pair[1] < 0:  # a flex, not a geom
        return
    world = contact_worldid[contact]
    table = world % geom_row.shape[0]
    row0 = geom_row[table, pair[0]]
    row1 = geom_row[table, pair[1]]
    if wp.max(row0, row1) < 0 or not due[world]:
        return
    bodies = sensor.net_forces_w.shape[1]
    wrench = contact_force_fn(
        cone,
        contact_frame,
        contact_friction,
        contact_dim,
        contact_efc_address,
        contact_adhesion,
        efc_force,
        njmax,
        nacon,
        world,
        contact,
        True,
    )
    force = wp.spatial_top(wrench)  # on the second geom
    if row0 >= 0:
        add_force(world * bodies + row0, geom_column[table, pair[1]], -force, sensor)
    if row1 >= 0:
        add_force(world * bodies + row1, geom_column[table, pair[0]], force, sensor)
