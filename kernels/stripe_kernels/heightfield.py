# SPDX-License-Identifier: Apache-2.0
"""Height-field contacts: touches of spheres, capsules and boxes with a height field, in the frame of the field.

The field has MuJoCo's form: ``nrow`` by ``ncol`` heights over ``[-x, x]`` by ``[-y, y]``, each cell cut into two
triangles from its corner (row + 1, column) to its corner (row, column + 1). Everything below the surface is solid.

A touch of a sphere is a local minimum of the distance from its centre to the surface. Touches are searched triangle by
triangle and found nearest first; a point on or below the tangent plane of a nearer touch does not count, so that edges
inside a smooth surface make no contacts. The touches of a capsule are those of the spheres at its ends, and the points
of its axis nearest to a ridge. The touches of a box are its corners below the surface, and the vertices of the surface
inside it.
"""

import warp as wp

__all__ = [
    "Field",
    "Touch",
    "Touches",
    "add_touch",
    "box_touch",
    "capsule_edge_touch",
    "field_cells",
    "field_height",
    "field_peak",
    "sphere_touch",
]

_COINCIDE = wp.constant(1.0e-4)
"""Least height of a further touch above the tangent planes of those found before [m]."""


@wp.struct
class Field:
    """A height field of MuJoCo."""

    heights: wp.array[float]
    """Heights of all fields of the model, as shares of ``size[2]``, rows one after another."""
    adr: int
    """Index of this field's first height."""
    nrow: int
    """Number of rows, along y."""
    ncol: int
    """Number of columns, along x."""
    size: wp.vec4
    """Half extents in x and y, scale of the heights, depth of the base [m]."""


@wp.struct
class Touch:
    """Point of contact between a shape and the surface, in the frame of the field."""

    found: bool
    """Whether there is one."""
    dist: float
    """Distance, negative in penetration [m]."""
    point: wp.vec3
    """Point on the surface [m]."""
    normal: wp.vec3
    """Unit normal, from the surface to the body."""


@wp.struct
class Touches:
    """Touches found so far, nearest first, at most three."""

    count: int
    """Number of touches found, those that did not fit included."""
    point0: wp.vec3
    normal0: wp.vec3
    point1: wp.vec3
    normal1: wp.vec3
    point2: wp.vec3
    normal2: wp.vec3


@wp.func
def add_touch(touches: Touches, touch: Touch) -> Touches:
    """Append a touch; one beyond the third is counted but not kept."""
    if touches.count == 0:
        touches.point0 = touch.point
        touches.normal0 = touch.normal
    elif touches.count == 1:
        touches.point1 = touch.point
        touches.normal1 = touch.normal
    elif touches.count == 2:
        touches.point2 = touch.point
        touches.normal2 = touch.normal
    touches.count += 1
    return touches


@wp.func
def field_height(field: Field, row: int, col: int) -> float:
    """Height of a vertex [m]."""
    return field.heights[field.adr + row * field.ncol + col] * field.size[2]


@wp.func
def _vertex(field: Field, row: int, col: int) -> wp.vec3:
    """Position of a vertex in the frame of the field [m]."""
    x = 2.0 * field.size[0] * float(col) / float(field.ncol - 1) - field.size[0]
    y = 2.0 * field.size[1] * float(row) / float(field.nrow - 1) - field.size[1]
    return wp.vec3(x, y, field_height(field, row, col))


@wp.func
def field_cells(field: Field, lower: wp.vec3, upper: wp.vec3) -> wp.vec4i:
    """Cells below an axis-aligned box: first and last column, first and last row; empty where first exceeds last."""
    sx = 0.5 * float(field.ncol - 1) / field.size[0]
    sy = 0.5 * float(field.nrow - 1) / field.size[1]
    c0 = wp.max(0, int(wp.floor((lower[0] + field.size[0]) * sx)))
    c1 = wp.min(field.ncol - 2, int(wp.floor((upper[0] + field.size[0]) * sx)))
    r0 = wp.max(0, int(wp.floor((lower[1] + field.size[1]) * sy)))
    r1 = wp.min(field.nrow - 2, int(wp.floor((upper[1] + field.size[1]) * sy)))
    return wp.vec4i(c0, c1, r0, r1)


@wp.func
def field_peak(field: Field, lower: wp.vec3, upper: wp.vec3) -> float:
    """Height of the highest vertex of the cells below a box [m]; -1e30 where there are none."""
    cells = field_cells(field, lower, upper)
    peak = wp.float32(-1.0e30)
    for row in range(cells[2], cells[3] + 2):
        for col in range(cells[0], cells[1] + 2):
            peak = wp.max(peak, field_height(field, row, col))
    return peak


@wp.func
def _closest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Point of a triangle nearest to ``p`` (Ericson, Real-Time Collision Detection, 5.1.5)."""
    # Voronoi regions in Ericson's order: each test relies on the ones before. Vertices first, then edges, then the
    # inside, whose barycentric coordinates are va, vb and vc over their sum.
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = wp.dot(ab, ap), wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return a
    bp = p - b
    d3, d4 = wp.dot(ab, bp), wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return b
    cp = p - c
    d5, d6 = wp.dot(ab, cp), wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return c
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return a + ab * (d1 / (d1 - d3))
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return a + ac * (d2 / (d2 - d6))
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and (d4 - d3) >= 0.0 and (d5 - d6) >= 0.0:
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    return a + ab * (vb / (va + vb + vc)) + ac * (vc / (va + vb + vc))


@wp.func
def _is_above_planes(touches: Touches, point: wp.vec3) -> bool:
    """Whether a point lies above the tangent planes of the touches found so far."""
    if touches.count > 0 and wp.dot(point - touches.point0, touches.normal0) <= _COINCIDE:
        return False
    if touches.count > 1 and wp.dot(point - touches.point1, touches.normal1) <= _COINCIDE:
        return False
    return not (touches.count > 2 and wp.dot(point - touches.point2, touches.normal2) <= _COINCIDE)


@wp.func
def _is_apart(touches: Touches, point: wp.vec3) -> bool:
    """Whether a point is at least 1 mm away from the touches found so far."""
    if touches.count > 0 and wp.length(point - touches.point0) < 1.0e-3:
        return False
    if touches.count > 1 and wp.length(point - touches.point1) < 1.0e-3:
        return False
    return not (touches.count > 2 and wp.length(point - touches.point2) < 1.0e-3)


@wp.func
def _upward_normal(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Upward unit normal of a triangle whose vertices are counterclockwise, seen from above."""
    return wp.normalize(wp.cross(b - a, c - a))


@wp.func
def _nearer_touch(best: Touch, centre: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3, touches: Touches) -> Touch:
    """Touch of a point above the surface with a triangle, if it is nearer than ``best``, else ``best``."""
    normal = _upward_normal(a, b, c)
    # The point is above the surface, so a triangle that it is below faces away, on the far side of a ridge.
    if wp.dot(centre - a, normal) < 0.0:
        return best
    point = _closest_on_triangle(centre, a, b, c)
    offset = centre - point
    dist = wp.length(offset)
    if dist < best.dist and _is_above_planes(touches, point):
        best.found = True
        best.dist = dist
        best.point = point
        # wp.where evaluates both values, hence the bound of the divisor.
        best.normal = wp.where(dist > 1.0e-7, offset / wp.max(dist, 1.0e-7), normal)
    return best


@wp.func
def _shallower_touch(best: Touch, centre: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> Touch:
    """Touch of a point below the surface with a triangle, if it is less deep than ``best``, else ``best``.

    Only a triangle that the perpendicular from the point meets counts.
    """
    normal = _upward_normal(a, b, c)
    above = wp.dot(centre - a, normal)
    foot = centre - above * normal
    beside = wp.length(_closest_on_triangle(foot, a, b, c) - foot)
    if above <= 0.0 and above > best.dist and beside < 1.0e-5:
        best.dist = above
        best.point = foot
        best.normal = normal
    return best


@wp.func
def _touch_in_column(field: Field, centre: wp.vec3) -> Touch:
    """Touch with the triangle straight above or below a point; ``dist`` is the distance to the triangle's plane."""
    touch = Touch()
    u = (centre[0] + field.size[0]) * 0.5 * float(field.ncol - 1) / field.size[0]
    v = (centre[1] + field.size[1]) * 0.5 * float(field.nrow - 1) / field.size[1]
    col, row = int(wp.floor(u)), int(wp.floor(v))
    if col < 0 or col > field.ncol - 2 or row < 0 or row > field.nrow - 2:
        return touch
    a = _vertex(field, row, col + 1)
    normal = _upward_normal(_vertex(field, row, col), a, _vertex(field, row + 1, col))
    if (u - float(col)) + (v - float(row)) > 1.0:  # beyond the diagonal; ``a`` is a vertex of both triangles
        normal = _upward_normal(a, _vertex(field, row + 1, col + 1), _vertex(field, row + 1, col))
    touch.found = True
    touch.dist = wp.dot(centre - a, normal)
    touch.point = centre - touch.dist * normal
    touch.normal = normal
    return touch


@wp.func
def sphere_touch(field: Field, centre: wp.vec3, radius: float, reach: float, touches: Touches) -> Touch:
    """Find the nearest touch of a sphere that is not among those found so far.

    Args:
        field: The field.
        centre: Centre of the sphere [m].
        radius: Its radius [m].
        reach: Greatest distance between sphere and surface [m].
        touches: Touches found so far; a sphere whose centre is below the surface has one touch only.
    """
    best = _touch_in_column(field, centre)
    inside = best.found and best.dist < 0.0
    size = radius + reach
    if not inside:
        best.found = False
        best.dist = size
    elif touches.count > 0:
        best.found = False
        return best
    cells = field_cells(field, centre - wp.vec3(size, size, size), centre + wp.vec3(size, size, size))
    for row in range(cells[2], cells[3] + 1):
        for col in range(cells[0], cells[1] + 1):
            p00, p01 = _vertex(field, row, col), _vertex(field, row, col + 1)
            p10, p11 = _vertex(field, row + 1, col), _vertex(field, row + 1, col + 1)
            if inside:
                best = _shallower_touch(best, centre, p00, p01, p10)
                best = _shallower_touch(best, centre, p01, p11, p10)
            # A cell whose vertices are all lower than the best distance reaches cannot hold a nearer point.
            elif wp.max(wp.max(p00[2], p01[2]), wp.max(p10[2], p11[2])) >= centre[2] - best.dist:
                best = _nearer_touch(best, centre, p00, p01, p10, touches)
                best = _nearer_touch(best, centre, p01, p11, p10, touches)
    best.dist = best.dist - radius
    return best


@wp.func
def _nearer_ridge_touch(
    best: Touch,
    start: wp.vec3,
    end: wp.vec3,
    a: wp.vec3,
    b: wp.vec3,
    left: wp.vec3,
    right: wp.vec3,
    touches: Touches,
) -> Touch:
    """Touch of an axis with the edge ``a`` to ``b`` of two triangles, if it is nearer than ``best``, else ``best``.

    ``left`` and ``right`` are the other vertices of the triangles, left counterclockwise after ``a``, ``b``. Only a
    ridge counts: an edge at which the surface bends down.
    """
    if wp.dot(right - a, _upward_normal(a, b, left)) > -1.0e-5:
        return best  # level, or a valley
    st = wp.closest_point_edge_edge(start, end, a, b, 1.0e-8)
    if st[0] <= 1.0e-3 or st[0] >= 1.0 - 1.0e-3:
        return best  # the spheres at the ends have touches of their own
    point = a + (b - a) * st[1]
    offset = start + (end - start) * st[0] - point
    dist = wp.length(offset)
    # The point is the nearest one of both triangles only if neither goes on towards the axis.
    nearest = wp.dot(offset, left - point) <= 1.0e-5 and wp.dot(offset, right - point) <= 1.0e-5
    if nearest and dist > 1.0e-6 and offset[2] > 0.0 and dist < best.dist and _is_apart(touches, point):
        best.found = True
        best.dist = dist
        best.point = point
        best.normal = offset / dist
    return best


@wp.func
def capsule_edge_touch(
    field: Field, start: wp.vec3, end: wp.vec3, radius: float, reach: float, touches: Touches
) -> Touch:
    """Find the nearest touch between a capsule's axis, its ends left out, and a ridge of the surface.

    Args:
        field: The field.
        start: One end of the axis [m].
        end: The other [m].
        radius: Radius of the capsule [m].
        reach: Greatest distance between capsule and surface [m].
        touches: Touches found so far.
    """
    best = Touch()
    best.dist = radius + reach
    margin = wp.vec3(best.dist, best.dist, best.dist)
    lower = wp.min(start, end) - margin
    cells = field_cells(field, lower, wp.max(start, end) + margin)
    # Each cell looks at three edges: its lower, its left and its diagonal one; the others belong to its neighbours.
    # Hence one more row and column. The edges of the field's border have but one triangle and are no ridges.
    for row in range(wp.max(cells[2], 1), wp.min(cells[3] + 1, field.nrow - 2) + 1):
        for col in range(wp.max(cells[0], 1), wp.min(cells[1] + 1, field.ncol - 2) + 1):
            p00, p01 = _vertex(field, row, col), _vertex(field, row, col + 1)
            p10, p11 = _vertex(field, row + 1, col), _vertex(field, row + 1, col + 1)
            if wp.max(wp.max(p00[2], p01[2]), p10[2]) >= lower[2]:
                below, beside = _vertex(field, row - 1, col + 1), _vertex(field, row + 1, col - 1)
                best = _nearer_ridge_touch(best, start, end, p00, p01, p10, below, touches)
                best = _nearer_ridge_touch(best, start, end, p10, p00, p01, beside, touches)
                best = _nearer_ridge_touch(best, start, end, p01, p10, p00, p11, touches)
    best.dist = best.dist - radius
    return best


@wp.func
def _deeper_vertex_touch(
    best: Touch, vertex: wp.vec3, pos: wp.vec3, rot: wp.mat33, half: wp.vec3, touches: Touches
) -> Touch:
    """Touch of a vertex of the surface inside a box, if it is deeper than ``best``, else ``best``."""
    # The depth is that to the nearest side that faces down: only through such a side the ground can leave the box.
    local = wp.transpose(rot) * (vertex - pos)
    depth, normal = wp.float32(1.0e6), wp.vec3(0.0, 0.0, 1.0)
    for axis in range(3):
        for side in range(2):
            sign = 1.0 - 2.0 * float(side)
            left = half[axis] - sign * local[axis]
            if left < 0.0:
                return best
            outward = sign * wp.vec3(rot[0, axis], rot[1, axis], rot[2, axis])
            if outward[2] < -0.1 and left < depth:
                depth, normal = left, -outward
    if depth < 1.0e5 and -depth < best.dist and _is_apart(touches, vertex):
        best.found = True
        best.dist = -depth
        best.point = vertex
        best.normal = normal
    return best


@wp.func
def box_touch(field: Field, pos: wp.vec3, rot: wp.mat33, half: wp.vec3, reach: float, touches: Touches) -> Touch:
    """Find the deepest touch of a box that is not among those found so far.

    Args:
        field: The field.
        pos: Centre of the box [m].
        rot: Its orientation.
        half: Its half extents [m].
        reach: Greatest distance between box and surface [m].
        touches: Touches found so far.
    """
    best = Touch()
    best.dist = reach
    none = Touches()
    extent = wp.vec3()
    for i in range(3):
        extent[i] = wp.abs(rot[i, 0]) * half[0] + wp.abs(rot[i, 1]) * half[1] + wp.abs(rot[i, 2]) * half[2]
    for corner in range(8):
        # The three bits of ``corner`` are the signs along x, y and z.
        sign = wp.vec3(1.0 - 2.0 * float(corner & 1), 1.0 - float(corner & 2), 1.0 - 0.5 * float(corner & 4))
        p = pos + rot * wp.cw_mul(sign, half)
        # A corner is a sphere of radius 0. It gets no touches to avoid: corners lie side by side on a flat ground, on
        # each other's tangent planes, and all of them must count.
        touch = sphere_touch(field, p, 0.0, wp.max(reach, 0.0) + 1.0e-6, none)
        if touch.found and touch.dist < best.dist and _is_apart(touches, touch.point):
            best = touch
    cells = field_cells(field, pos - extent, pos + extent)
    for row in range(cells[2], cells[3] + 2):
        for col in range(cells[0], cells[1] + 2):
            vertex = _vertex(field, row, col)
            if vertex[2] >= pos[2] - extent[2]:
                best = _deeper_vertex_touch(best, vertex, pos, rot, half, touches)
    return best
