# SPDX-License-Identifier: Apache-2.0
"""A triangle mesh seen from above, as heights on a grid."""

import warp as wp

__all__ = ["rasterize_from_above"]

_SURFACES = wp.constant(16)
"""Most surfaces that are looked at below a point."""


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
    """The highest surface at each point, and how far below it another surface faces up.

    Args:
        mesh: Id of the mesh.
        x: x of the columns [m], shape ``(ncol,)``.
        y: y of the rows [m], shape ``(nrow,)``.
        top: A height above the mesh [m].
        bottom: A height below it [m].
        heights: Output [m], shape ``(nrow, ncol)``; ``bottom`` where there is nothing.
        lost: Output [m], shape ``(nrow, ncol)``: depth of the next surface that faces up, 0 if there is none.
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
        if covered == 1 and up > 1.0e-3:
            depth = wp.max(depth, height - z)
            covered = 0
        if up < -1.0e-3:
            covered = 1
        z = z - 1.0e-4
        found += 1
    heights[row, col] = height
    lost[row, col] = depth
