# SPDX-License-Identifier: Apache-2.0
"""Ground contacts for MuJoCo Warp: spheres, capsules and boxes on height fields, added to its own contacts."""

import warp as wp
from mujoco_warp._src.collision_core import contact_margin_gap, contact_material_params, write_contact
from mujoco_warp._src.math import make_frame
from mujoco_warp._src.types import GeomType, vec5

from .heightfield import Field, Touch, Touches, add_touch, box_touch, capsule_edge_touch, field_peak, sphere_touch

__all__ = ["CONTACT_FIELDS", "MODEL_FIELDS", "add_ground_contacts"]

MODEL_FIELDS = (
    "geom_type", "geom_dataid", "geom_size", "hfield_adr", "hfield_nrow", "hfield_ncol", "hfield_size", "hfield_data",
    "geom_condim", "geom_priority", "geom_solmix", "geom_solref", "geom_solimp", "geom_friction", "geom_margin",
    "geom_gap", "geom_adhesion", "pair_dim", "pair_solref", "pair_solreffriction", "pair_solimp", "pair_margin",
    "pair_gap", "pair_adhesion", "pair_friction",
)  # fmt: skip
"""Fields of MuJoCo Warp's model that the kernel takes, in the order of its arguments."""
CONTACT_FIELDS = (
    "dist", "pos", "frame", "includemargin", "friction", "solref", "solreffriction", "solimp", "dim", "geom",
    "efc_address", "worldid", "type", "geomcollisionid", "adhesion",
)  # fmt: skip
"""Fields of MuJoCo Warp's contacts that the kernel writes, in the order of its arguments."""


@wp.func
def _half_extents(kind: int, rot: wp.mat33, size: wp.vec3) -> wp.vec3:
    """Half extents of a shape's bounding box along the axes of the field [m]."""
    half = wp.vec3(size[0], size[0], size[0])
    if kind == int(GeomType.CAPSULE):
        half += wp.vec3(wp.abs(rot[0, 2]), wp.abs(rot[1, 2]), wp.abs(rot[2, 2])) * size[1]
    if kind == int(GeomType.BOX):
        for i in range(3):
            half[i] = wp.abs(rot[i, 0]) * size[0] + wp.abs(rot[i, 1]) * size[1] + wp.abs(rot[i, 2]) * size[2]
    return half


@wp.func
def _find_touch(
    index: int, kind: int, field: Field, pos: wp.vec3, rot: wp.mat33, size: wp.vec3, reach: float, touches: Touches
) -> Touch:
    """Find the touch number ``index`` of a shape; a capsule has two at each end, then two along its axis."""
    if kind == int(GeomType.BOX):
        return box_touch(field, pos, rot, size, reach, touches)
    half = wp.vec3(rot[0, 2], rot[1, 2], rot[2, 2]) * size[1]
    if kind == int(GeomType.CAPSULE) and index >= 4:
        return capsule_edge_touch(field, pos - half, pos + half, size[0], reach, touches)
    centre = pos
    if kind == int(GeomType.CAPSULE):
        centre = pos + wp.where(index < 2, 1.0, -1.0) * half
    return sphere_touch(field, centre, size[0], reach, touches)


@wp.kernel(enable_backward=False)
def add_ground_contacts(
    pairs: wp.array[wp.vec2i],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    naconmax: int,
    geom_type: wp.array[int],
    geom_dataid: wp.array2d[int],
    geom_size: wp.array2d[wp.vec3],
    hfield_adr: wp.array[int],
    hfield_nrow: wp.array[int],
    hfield_ncol: wp.array[int],
    hfield_size: wp.array[wp.vec4],
    hfield_data: wp.array[float],
    geom_condim: wp.array[int],
    geom_priority: wp.array[int],
    geom_solmix: wp.array2d[float],
    geom_solref: wp.array2d[wp.vec2],
    geom_solimp: wp.array2d[vec5],
    geom_friction: wp.array2d[wp.vec3],
    geom_margin: wp.array2d[float],
    geom_gap: wp.array2d[float],
    geom_adhesion: wp.array2d[float],
    pair_dim: wp.array[int],
    pair_solref: wp.array2d[wp.vec2],
    pair_solreffriction: wp.array2d[wp.vec2],
    pair_solimp: wp.array2d[vec5],
    pair_margin: wp.array2d[float],
    pair_gap: wp.array2d[float],
    pair_adhesion: wp.array2d[float],
    pair_friction: wp.array2d[vec5],
    contact_dist: wp.array[float],
    contact_pos: wp.array[wp.vec3],
    contact_frame: wp.array[wp.mat33],
    contact_includemargin: wp.array[float],
    contact_friction: wp.array[vec5],
    contact_solref: wp.array[wp.vec2],
    contact_solreffriction: wp.array[wp.vec2],
    contact_solimp: wp.array[vec5],
    contact_dim: wp.array[int],
    contact_geom: wp.array[wp.vec2i],
    contact_efc_address: wp.array2d[int],
    contact_worldid: wp.array[int],
    contact_type: wp.array[int],
    contact_geomcollisionid: wp.array[int],
    contact_adhesion: wp.array[float],
    nacon: wp.array[int],
):
    """Add the contacts of pairs of a height field and another geom; a thread for each pair of each world."""
    # Neighbouring threads are the worlds of one pair: their shapes are of one kind, and mostly all on the ground or all
    # above it, so that the threads of a warp take the same branches.
    index, world = wp.tid()
    pair = pairs[index]
    ground, geom = pair[0], pair[1]
    margin, gap = contact_margin_gap(geom_margin, geom_gap, pair_margin, pair_gap, pair, -1, world)
    # Fields of MuJoCo Warp's model have one row for all worlds or one for each, hence the modulo.
    data = geom_dataid[world % geom_dataid.shape[0], ground]
    field = Field()
    field.heights = hfield_data
    field.adr = hfield_adr[data]
    field.nrow = hfield_nrow[data]
    field.ncol = hfield_ncol[data]
    field.size = hfield_size[data]

    frame = geom_xmat[world, ground]
    pos = wp.transpose(frame) * (geom_xpos[world, geom] - geom_xpos[world, ground])
    rot = wp.transpose(frame) * geom_xmat[world, geom]
    size = geom_size[world % geom_size.shape[0], geom]
    kind = geom_type[geom]
    extent = _half_extents(kind, rot, size) + wp.vec3(1.0, 1.0, 1.0) * (margin + gap)
    if field_peak(field, pos - extent, pos + extent) < pos[2] - extent[2]:  # all of the shape is above the ground
        return
    slots = 6
    if kind != int(GeomType.CAPSULE):
        slots = 4
    touches, touch, search = Touches(), Touch(), wp.bool(True)
    for slot in range(slots):
        if kind == int(GeomType.CAPSULE) and (slot == 2 or slot == 4):
            touches.count = 0  # the other end of the capsule, then its axis: each is searched on its own
            search = wp.bool(True)
        if search:
            touch = _find_touch(slot, kind, field, pos, rot, size, margin + gap, touches)
        search = search and touch.found  # touches come nearest first, so after a miss there is none
        if search:
            touches = add_touch(touches, touch)
            condim, friction, solref, solreffriction, solimp, adhesion = contact_material_params(
                geom_condim,
                geom_priority,
                geom_solmix,
                geom_solref,
                geom_solimp,
                geom_friction,
                geom_adhesion,
                pair_dim,
                pair_solref,
                pair_solreffriction,
                pair_solimp,
                pair_adhesion,
                pair_friction,
                pair,
                -1,
                world,
            )
            write_contact(
                naconmax,
                slot,
                touch.dist,
                # MuJoCo's contact point lies halfway between the two surfaces.
                geom_xpos[world, ground] + frame * (touch.point + 0.5 * touch.dist * touch.normal),
                make_frame(frame * touch.normal),
                margin,
                gap,
                condim,
                friction,
                solref,
                solreffriction,
                solimp,
                adhesion,
                pair,
                wp.vec2i(-1, -1),
                world,
                contact_dist,
                contact_pos,
                contact_frame,
                contact_includemargin,
                contact_friction,
                contact_solref,
                contact_solreffriction,
                contact_solimp,
                contact_dim,
                contact_geom,
                contact_efc_address,
                contact_worldid,
                contact_type,
                contact_geomcollisionid,
                contact_adhesion,
                nacon,
            )
