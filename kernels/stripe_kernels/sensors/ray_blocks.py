# SPDX-License-Identifier: Apache-2.0
"""Rays against a height field by blocks: cells are visited only where the ray comes between the heights of a block.

A block is eight by eight cells with its lowest and highest height. A ray of a camera skips the blocks that it passes
above, and marches through the cells of the others as :func:`stripe_kernels.sensors.ray_field.march_field` does.
"""

import warp as wp

from .ray_field import RayField, leave_index, pass_cell, span_in_field

__all__ = ["BLOCK", "FieldHit", "bound_blocks", "field_normal", "march_blocks"]

BLOCK = wp.constant(8)
"""Cells along a side of a block."""
_HUGE = wp.constant(1.0e30)
_SLACK = wp.constant(1.0e-4)
"""Distance from a block's heights within which its cells are visited, for rounding [m]."""


@wp.struct
class FieldHit:
    """Where a ray meets a height field."""

    distance: float
    """Distance along the ray [m]; -1 if it meets nothing."""
    row: int
    """Cell."""
    col: int
    """Cell."""
    far_side: wp.bool
    """Whether it is the triangle at the corner (row + 1, col + 1)."""


@wp.kernel(enable_backward=False)
def bound_blocks(heights: wp.array2d[float], blocks: wp.array2d[wp.vec2]):
    """Compute the lowest and highest height of each block; one thread a block."""
    i, j = wp.tid()
    low, high = wp.float32(_HUGE), wp.float32(-_HUGE)
    for row in range(i * BLOCK, wp.min((i + 1) * BLOCK + 1, heights.shape[0])):
        for col in range(j * BLOCK, wp.min((j + 1) * BLOCK + 1, heights.shape[1])):
            low, high = wp.min(low, heights[row, col]), wp.max(high, heights[row, col])
    blocks[i, j] = wp.vec2(low, high)


@wp.func
def field_normal(field: RayField, hit: FieldHit) -> wp.vec3:
    """Unit normal, upwards, of the triangle that a ray meets."""
    row, col = hit.row, hit.col
    right, above = field.heights[row, col + 1], field.heights[row + 1, col]
    corner = wp.where(hit.far_side, field.heights[row + 1, col + 1], field.heights[row, col])
    dx, dy = right - corner, above - corner
    if hit.far_side:
        dx, dy = corner - above, corner - right
    return wp.normalize(wp.vec3(-dx / field.cell[0], -dy / field.cell[1], 1.0))


@wp.func
def march_blocks(
    field: RayField, blocks: wp.array2d[wp.vec2], start: wp.vec3, direction: wp.vec3, limit: float
) -> FieldHit:
    """Where a ray first meets the surface.

    Args:
        field: The height field.
        blocks: Lowest and highest height of each block [m].
        start: Start of the ray in the world [m].
        direction: Unit vector along it.
        limit: Length of the ray [m].
    """
    hit = FieldHit()
    hit.distance = -1.0
    nrow, ncol = field.heights.shape[0], field.heights.shape[1]
    span = span_in_field(field, start, direction, limit)
    if not (span[0] <= span[1]):  # false for NaN too
        return hit
    u0, v0 = (start[0] - field.lower[0]) / field.cell[0], (start[1] - field.lower[1]) / field.cell[1]
    du, dv = direction[0] / field.cell[0], direction[1] / field.cell[1]
    size = 1.0 / float(BLOCK)
    t = span[0]
    bcol = wp.clamp(int(wp.floor((u0 + t * du) * size)), 0, blocks.shape[1] - 1)
    brow = wp.clamp(int(wp.floor((v0 + t * dv) * size)), 0, blocks.shape[0] - 1)
    side = wp.float32(0.0)  # 1 above the surface, -1 below it, 0 before the first triangle
    while True:
        next_u, next_v = leave_index(bcol, u0 * size, du * size), leave_index(brow, v0 * size, dv * size)
        end = wp.min(wp.min(next_u, next_v), span[1])
        bounds = blocks[brow, bcol]
        z0, z1 = start[2] + t * direction[2], start[2] + end * direction[2]
        if wp.min(z0, z1) > bounds[1] + _SLACK:
            side = 1.0
        elif wp.max(z0, z1) < bounds[0] - _SLACK:
            side = -1.0
        else:
            # The cells of this block, from ``t`` to ``end``; see ``march_field``.
            c0, r0 = bcol * BLOCK, brow * BLOCK
            c1, r1 = wp.min(c0 + BLOCK, ncol - 1) - 1, wp.min(r0 + BLOCK, nrow - 1) - 1
            col = wp.clamp(int(wp.floor(u0 + t * du)), c0, c1)
            row = wp.clamp(int(wp.floor(v0 + t * dv)), r0, r1)
            inside = wp.bool(True)
            while inside:
                cell_u, cell_v = leave_index(col, u0, du), leave_index(row, v0, dv)
                leave = wp.max(wp.min(wp.min(cell_u, cell_v), end), t)
                corners = wp.vec4(
                    field.heights[row, col],
                    field.heights[row, col + 1],
                    field.heights[row + 1, col],
                    field.heights[row + 1, col + 1],
                )
                u, v = u0 - float(col), v0 - float(row)
                passed = pass_cell(corners, u, v, start[2], du, dv, direction[2], t, leave, side)
                if passed.distance >= 0.0:
                    hit.distance = passed.distance
                    hit.row = row
                    hit.col = col
                    hit.far_side = passed.far_side
                    return hit
                side = passed.side
                t = leave
                if leave >= end:
                    inside = False
                elif cell_u <= cell_v:
                    col += wp.where(du > 0.0, 1, -1)
                else:
                    row += wp.where(dv > 0.0, 1, -1)
                if col < c0 or col > c1 or row < r0 or row > r1:
                    inside = False
        if end >= span[1]:
            return hit
        t = end
        # Steps are counted in whole blocks, never recomputed from ``t``: rounding could stay in a block for ever.
        if next_u <= next_v:
            bcol += wp.where(du > 0.0, 1, -1)
        else:
            brow += wp.where(dv > 0.0, 1, -1)
        if bcol < 0 or bcol > blocks.shape[1] - 1 or brow < 0 or brow > blocks.shape[0] - 1:
            return hit
