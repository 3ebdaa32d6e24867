# SPDX-License-Identifier: Apache-2.0
"""Given contacts: those that others' collision detection found, by world and in an order that does not vary."""

import warp as wp
from mujoco_warp._src.types import ContactType, vec5

__all__ = ["FIELDS", "GIVEN_SIZE", "list_contacts", "sort_contacts"]

FIELDS = (
    "dist", "pos", "frame", "friction", "solref", "solreffriction", "solimp", "includemargin", "dim", "geom",
    "geomcollisionid",
)  # fmt: skip
"""Fields of MuJoCo Warp's contacts that ``sort_contacts`` takes, in the order of its arguments."""
GIVEN_SIZE = wp.constant(31)
"""Numbers of a given contact, see ``GivenField`` in fused/world.h."""

_FOR_SOLVER = wp.constant(int(ContactType.CONSTRAINT))


@wp.kernel(enable_backward=False)
def list_contacts(
    nacon: wp.array[int],
    worldid: wp.array[int],
    kind: wp.array[int],
    dist: wp.array[float],
    includemargin: wp.array[float],
    count: wp.array[int],
    found: wp.array2d[int],
):
    """List the contacts of each world that act, in any order; a thread for each contact.

    Args:
        nacon: Number of contacts of all worlds, shape ``(1,)``.
        worldid: World of each.
        kind: ``mujoco_warp.ContactType`` of each: whether it is for the solver.
        dist: Distance of each [m].
        includemargin: Distance below which it acts [m].
        count: Output, numbers of contacts, those without a place included; 0 before, shape ``(num_worlds,)``.
        found: Output, their indices, shape ``(num_worlds, places)``.
    """
    contact = wp.tid()
    if contact >= nacon[0] or (kind[contact] & _FOR_SOLVER) == 0 or dist[contact] >= includemargin[contact]:
        return
    world = worldid[contact]
    place = wp.atomic_add(count, world, 1)
    if place < found.shape[1]:
        found[world, place] = contact


@wp.func
def _comes_before(a: int, b: int, geom: wp.array[wp.vec2i], number: wp.array[int], pos: wp.array[wp.vec3]) -> bool:
    """Whether a contact comes before another: by its geoms, then by its number among those of the geoms, then by place.

    MuJoCo Warp's contacts of two geoms have different numbers, those of Newton's collision detection have none.
    """
    if geom[a][0] != geom[b][0]:
        return geom[a][0] < geom[b][0]
    if geom[a][1] != geom[b][1]:
        return geom[a][1] < geom[b][1]
    if number[a] != number[b]:
        return number[a] < number[b]
    for i in range(3):
        if pos[a][i] != pos[b][i]:
            return pos[a][i] < pos[b][i]
    return a < b


@wp.kernel(enable_backward=False)
def sort_contacts(
    count: wp.array[int],
    found: wp.array2d[int],
    dist: wp.array[float],
    pos: wp.array[wp.vec3],
    frame: wp.array[wp.mat33],
    friction: wp.array[vec5],
    solref: wp.array[wp.vec2],
    solreffriction: wp.array[wp.vec2],
    solimp: wp.array[vec5],
    includemargin: wp.array[float],
    dim: wp.array[int],
    geom: wp.array[wp.vec2i],
    geomcollisionid: wp.array[int],
    given: wp.array3d[float],
):
    """Write the contacts of each world in order, as the fused step takes them; threads (world, place).

    Args:
        count: Numbers of the worlds' contacts, shape ``(num_worlds,)``.
        found: Their indices, shape ``(num_worlds, places)``.
        dist: Distances of MuJoCo Warp's contacts [m], shape ``(naconmax,)`` as of the following fields of them.
        pos: Positions [m].
        frame: Normals and tangents, in rows.
        friction: Coefficients of friction.
        solref: Solver parameters along the normal.
        solreffriction: Solver parameters along the tangents.
        solimp: Impedances.
        includemargin: Distances below which they act [m].
        dim: Dimensions of their forces.
        geom: Their two geoms.
        geomcollisionid: Their numbers among those of their geoms.
        given: Output, the contacts, shape ``(num_worlds, places, GIVEN_SIZE)``.
    """
    world, place = wp.tid()
    total = wp.min(count[world], found.shape[1])
    if place >= total:
        return
    contact = found[world, place]
    rank = wp.int32(0)
    for other in range(total):
        if _comes_before(found[world, other], contact, geom, geomcollisionid, pos):
            rank += 1
    given[world, rank, 0] = dist[contact]
    for i in range(3):
        given[world, rank, 1 + i] = pos[contact][i]
        for j in range(3):
            given[world, rank, 4 + 3 * i + j] = frame[contact][i, j]
    for i in range(5):
        given[world, rank, 13 + i] = friction[contact][i]
        given[world, rank, 22 + i] = solimp[contact][i]
    for i in range(2):
        given[world, rank, 18 + i] = solref[contact][i]
        given[world, rank, 20 + i] = solreffriction[contact][i]
        given[world, rank, 29 + i] = float(geom[contact][i])
    given[world, rank, 27] = includemargin[contact]
    given[world, rank, 28] = float(dim[contact])
