# SPDX-License-Identifier: Apache-2.0
"""Rasterisation of a triangle mesh, seen from above, into heights on a grid."""

import warp as wp

__all__ = ["rasterize_from_above"]

_SURFACES = wp.constant(16)
"""Largest number of surfaces that a ray passes below a point."""


@wp.kernel(enable_backward=False)
def rasterize_from_above(
    mesh: wp.uint64,
    x: wp.array[float],
    y: wp.array[float],
    top: float,
    bottom: float,
    heights: wp.array2d[float],
    lost: wp.array2d[float],
):
    """Find the highest surface at each point, and the ground that it hides; threads (row, column).

    Args:
        mesh: Id of the mesh.
        x: x of the columns [m], shape ``(ncol,)``.
        y: y of the rows [m], shape ``(nrow,)``.
        top: A height above the mesh [m].
        bottom: A height below it [m].
        heights: Output, height of the highest surface [m], shape ``(nrow, ncol)``; ``bottom`` where there is none.
        lost: Output, largest depth below it at which a surface under an overhang faces up [m], shape ``(nrow, ncol)``;
            0 if there is none.
    """
    row, col = wp.tid()
    down = wp.vec3(0.0, 0.0, -1.0)
    z = wp.float32(top)
    height = wp.float32(bottom)
    depth = wp.float32(0.0)
    found, covered = wp.int32(0), wp.int32(0)
    while found < _SURFACES:
        query = wp.mesh_query_ray(mesh, wp.vec3(x[col], y[row], z), down, z - bottom)
        if not query.result:
            break
        z = z - query.t
        up = query.normal[2]
        if found == 0:
            height = z
        # After an underside, a surface that faces up is ground which a height field cannot hold: the floor under a
        # bridge. Without an underside between them two surfaces are one solid. Walls have no part in either.
        if covered == 1 and up > 1.0e-3:
            depth = wp.max(depth, height - z)
            covered = 0
        if up < -1.0e-3:
            covered = 1
        z = z - 1.0e-4  # start the next ray below this surface, or it would hit the same one again
        found += 1
    heights[row, col] = height
    lost[row, col] = depth
