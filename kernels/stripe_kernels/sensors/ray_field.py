# SPDX-License-Identifier: Apache-2.0
"""Rays against a height field: vertical rays by a height lookup, slanted rays by a march from cell to cell.

A height field is ``nrow`` by ``ncol`` heights, rows along y; each cell is cut into two triangles from its corner
(row + 1, column) to its corner (row, column + 1), as Newton and MuJoCo do for contacts. It is a surface without
thickness: a ray that starts below it hits it from below.
"""

import warp as wp

__all__ = ["RayField", "field_height", "leave_index", "march_field", "pass_cell", "span_in_field"]

_HUGE = wp.constant(1.0e30)


@wp.struct
class RayField:
    """Height field in the world, for rays."""

    heights: wp.array2d[float]
    """Heights [m], shape ``(nrow, ncol)``; empty where there is no field."""
    lower: wp.vec2
    """World x and y of ``heights[0, 0]`` [m]."""
    cell: wp.vec2
    """Spacing in x and y [m]."""
    bounds: wp.array[float]
    """Lowest and highest height [m], shape ``(2,)``; an array, so that a recorded graph works with new heights too."""


@wp.func
def field_height(field: RayField, x: float, y: float) -> float:
    """Height of the surface at a point (x, y) of the world [m]; infinite outside the field."""
    u, v = (x - field.lower[0]) / field.cell[0], (y - field.lower[1]) / field.cell[1]
    nrow, ncol = field.heights.shape[0], field.heights.shape[1]
    # The condition is negated, so that NaN counts as outside: as an index it would be undefined.
    if not (u >= 0.0 and v >= 0.0 and u <= float(ncol - 1) and v <= float(nrow - 1)):
        return wp.inf
    col, row = wp.min(int(u), ncol - 2), wp.min(int(v), nrow - 2)
    u -= float(col)
    v -= float(row)
    right, above = field.heights[row, col + 1], field.heights[row + 1, col]
    if u + v <= 1.0:
        corner = field.heights[row, col]
        return corner + u * (right - corner) + v * (above - corner)
    corner = field.heights[row + 1, col + 1]
    return corner + (1.0 - u) * (above - corner) + (1.0 - v) * (right - corner)


@wp.func
def _clip_span(lower: float, upper: float, start: float, direction: float, span: wp.vec2) -> wp.vec2:
    """Part of ``span`` in which one coordinate of a ray is between two bounds; empty where first exceeds last."""
    # The slab method; a ray along the slab would divide by zero.
    if wp.abs(direction) < 1.0e-12:
        if start < lower or start > upper:
            return wp.vec2(1.0, 0.0)
        return span
    a, b = (lower - start) / direction, (upper - start) / direction
    return wp.vec2(wp.max(span[0], wp.min(a, b)), wp.min(span[1], wp.max(a, b)))


@wp.func
def span_in_field(field: RayField, start: wp.vec3, direction: wp.vec3, limit: float) -> wp.vec2:
    """Distances [m] between which a ray of length ``limit`` is in the box around a height field; empty where the first
    exceeds the second."""
    nrow, ncol = field.heights.shape[0], field.heights.shape[1]
    upper_x = field.lower[0] + field.cell[0] * float(ncol - 1)
    upper_y = field.lower[1] + field.cell[1] * float(nrow - 1)
    span = _clip_span(field.lower[0], upper_x, start[0], direction[0], wp.vec2(0.0, limit))
    span = _clip_span(field.lower[1], upper_y, start[1], direction[1], span)
    # 1 mm more than the heights' range, so that a ray which enters through a summit or a flat field is not lost.
    return _clip_span(field.bounds[0] - 1.0e-3, field.bounds[1] + 1.0e-3, start[2], direction[2], span)


@wp.func
def over_plane(corners: wp.vec4, u: float, v: float, z: float, far_side: bool) -> float:
    """Height of a point above the plane of one triangle of a cell [m]; ``corners`` are heights, row by row."""
    if far_side:
        return z - corners[3] - (1.0 - u) * (corners[2] - corners[3]) - (1.0 - v) * (corners[1] - corners[3])
    return z - corners[0] - u * (corners[1] - corners[0]) - v * (corners[2] - corners[0])


@wp.func
def leave_index(index: int, start: float, step: float) -> float:
    """Distance at which a ray leaves the cell or block ``index`` of an axis; ``start`` and ``step`` in such units."""
    if wp.abs(step) < 1.0e-12:
        return _HUGE
    return (float(wp.where(step > 0.0, index + 1, index)) - start) / step


@wp.struct
class CellPass:
    """Passage of a ray through a cell."""

    distance: float
    """Distance along the ray at which it meets the surface [m]; -1 if it does not in this cell."""
    side: float
    """1 if the ray leaves above the surface, -1 below it."""
    far_side: wp.bool
    """Whether it meets the triangle at the corner (row + 1, column + 1)."""


@wp.func
def pass_cell(
    corners: wp.vec4,
    u: float,
    v: float,
    z: float,
    du: float,
    dv: float,
    dz: float,
    enter: float,
    leave: float,
    side: float,
) -> CellPass:
    """Where a ray meets one of the two triangles of a cell.

    A hit is a change of the side of the surface on which the ray is, and that side is carried from triangle to
    triangle: computed anew in each, rounding could let a ray slip through an edge.

    Args:
        corners: Heights of the corners, row by row [m].
        u: Start of the ray in coordinates of the cell, along columns.
        v: Start along rows.
        z: Height of the start [m].
        du: Change of ``u`` along the ray [1/m].
        dv: Change of ``v`` [1/m].
        dz: Change of the height.
        enter: Distance at which the ray enters the cell [m].
        leave: Distance at which it leaves [m].
        side: Side of the surface before, 0 if it is not known.
    """
    passed = CellPass()
    passed.distance = -1.0
    passed.side = side
    # ``middle`` is where the ray crosses the cell's diagonal, from one triangle to the other.
    middle = leave
    if wp.abs(du + dv) > 1.0e-12:
        diagonal = (1.0 - u - v) / (du + dv)
        if diagonal > enter and diagonal < leave:
            middle = diagonal
    for part in range(2):
        first, last = wp.where(part == 0, enter, middle), wp.where(part == 0, middle, leave)
        if passed.distance < 0.0 and (part == 0 or middle < leave):
            far_side = u + v + 0.5 * (first + last) * (du + dv) > 1.0
            before = over_plane(corners, u + first * du, v + first * dv, z + first * dz, far_side)
            after = over_plane(corners, u + last * du, v + last * dv, z + last * dz, far_side)
            if passed.side == 0.0:
                passed.side = wp.where(before >= 0.0, 1.0, -1.0)
            if passed.side * after <= 0.0:
                share = wp.float32(0.0)
                if passed.side * before > 0.0:
                    share = before / (before - after)
                passed.distance = first + share * (last - first)
                passed.far_side = far_side
    return passed


@wp.func
def march_field(field: RayField, start: wp.vec3, direction: wp.vec3, limit: float) -> float:
    """Distance along a ray to the surface [m]; -1 if there is none within ``limit``.

    Args:
        field: The height field.
        start: Start of the ray in the world [m].
        direction: Unit vector along it.
        limit: Length of the ray [m].
    """
    # The ray visits the triangles in order, see `pass_cell`.
    nrow, ncol = field.heights.shape[0], field.heights.shape[1]
    span = span_in_field(field, start, direction, limit)
    if not (span[0] <= span[1]):  # false for NaN too
        return -1.0
    u0, v0 = (start[0] - field.lower[0]) / field.cell[0], (start[1] - field.lower[1]) / field.cell[1]
    du, dv = direction[0] / field.cell[0], direction[1] / field.cell[1]
    t = span[0]
    col = wp.clamp(int(wp.floor(u0 + t * du)), 0, ncol - 2)
    row = wp.clamp(int(wp.floor(v0 + t * dv)), 0, nrow - 2)
    side = wp.float32(0.0)  # 1 above the surface, -1 below it, 0 before the first triangle
    while True:
        next_u, next_v = leave_index(col, u0, du), leave_index(row, v0, dv)
        leave = wp.min(wp.min(next_u, next_v), span[1])
        a, b = field.heights[row, col], field.heights[row, col + 1]
        corners = wp.vec4(a, b, field.heights[row + 1, col], field.heights[row + 1, col + 1])
        u, v = u0 - float(col), v0 - float(row)  # start of the ray in coordinates of this cell
        passed = pass_cell(corners, u, v, start[2], du, dv, direction[2], t, leave, side)
        if passed.distance >= 0.0:
            return passed.distance
        side = passed.side
        if leave >= span[1]:
            return -1.0
        t = leave
        # Steps are counted in whole cells, never recomputed from ``t``: rounding could stay in a cell for ever.
        if next_u <= next_v:
            col += wp.where(du > 0.0, 1, -1)
        else:
            row += wp.where(dv > 0.0, 1, -1)
        if col < 0 or col > ncol - 2 or row < 0 or row > nrow - 2:
            return -1.0
