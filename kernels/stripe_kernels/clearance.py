# SPDX-License-Identifier: Apache-2.0
"""Clearance: distances from the centres of a grid's cells to the nearest face and the nearest edge of meshes."""

import warp as wp

__all__ = ["measure_clearance"]


@wp.kernel(enable_backward=False)
def measure_clearance(
    mesh: wp.uint64,
    edges: wp.uint64,
    is_solid: wp.array[int],
    low: wp.vec3,
    cell: float,
    columns: int,
    rows: int,
    unit: float,
    clearance: wp.array2d[wp.uint8],
):
    """Write for each cell a distance that its centre is not nearer to a face than, and the same of edges.

    A thread computes a cell.

    Args:
        mesh: The faces.
        edges: The edges, as narrow triangles; 0 for none.
        is_solid: Whether each face is one of a solid, shape ``(faces,)``.
        low: Lowest corner of the grid [m].
        cell: Size of a cell [m].
        columns: Cells along x; they are numbered along x, then y, then z.
        rows: Cells along y.
        unit: Unit of the distances [m].
        clearance: Output, in units, at most 255; that of faces is 0 behind faces of a solid, shape ``(cells, 2)``.
    """
    i = wp.tid()
    center = low + cell * wp.vec3(
        float(i % columns) + 0.5, float(i // columns % rows) + 0.5, float(i // (columns * rows)) + 0.5
    )
    more = 1.0e-4  # than rounding
    most = 255.0 * unit + more
    if edges != wp.uint64(0):
        nearest = wp.mesh_query_point_no_sign(edges, center, most)
        if nearest.result:
            offset = center - wp.mesh_eval_position(edges, nearest.face, nearest.u, nearest.v)
            clearance[i, 1] = in_units(wp.length(offset) - more, unit)
    found = wp.mesh_query_point_sign_normal(mesh, center, most)
    if not found.result:
        return
    offset = center - wp.mesh_eval_position(mesh, found.face, found.u, found.v)
    if is_solid[found.face] != 0 and found.sign < 0.0:
        clearance[i, 0] = wp.uint8(0)
        return
    clearance[i, 0] = in_units(wp.length(offset) - more, unit)


@wp.func
def in_units(distance: float, unit: float) -> wp.uint8:
    """A distance [m] in whole units, rounded down, from 0 to 255."""
    return wp.uint8(wp.clamp(wp.floor(distance / unit), 0.0, 255.0))
