# SPDX-License-Identifier: Apache-2.0
"""Start spots: kernels that find where a robot can stand on a triangle mesh, such as the floors of a building.

The room of a robot is an upright cylinder over a point of a floor. All kernels have one thread for each column of a
grid, or for each point.
"""

import warp as wp

__all__ = ["CLEAR", "INSIDE", "OBSTRUCTED", "UNEVEN", "check_spots", "find_surfaces"]

CLEAR = wp.constant(0)
"""Nothing is in the cylinder, and the ground below it is level."""
INSIDE = wp.constant(1)
"""The point lies inside a solid, such as the bottom of a cupboard."""
OBSTRUCTED = wp.constant(2)
"""Something is in the cylinder."""
UNEVEN = wp.constant(3)
"""The ground below the cylinder is not level, or has a hole."""

_SURFACES = wp.constant(64)
"""Largest number of surfaces that are looked at below a point."""
_SKIN = wp.constant(1.0e-4)
"""Distance below a surface from which the next one is looked for [m]."""
_RAY_SPACING = wp.constant(0.05)
"""Distance between the rays that look for holes in the ground [m]."""


@wp.kernel(enable_backward=False)
def find_surfaces(
    mesh: wp.uint64,
    points: wp.array[wp.vec2],
    top: float,
    bottom: float,
    least_up: float,
    height: float,
    heights: wp.array2d[float],
    counts: wp.array[int],
):
    """Find surfaces at each point of a grid that are not steep and have free space above.

    Args:
        mesh: Id of the mesh.
        points: x and y of the columns [m], shape ``(columns,)``.
        top: A height above the mesh [m].
        bottom: A height below it [m].
        least_up: Smallest vertical part of the unit normal, of either sign: files differ in which side is outside.
        height: Free space that is needed above [m].
        heights: Output, heights of the surfaces [m], shape ``(columns, layers)``, from the top; those that do not fit
            are counted alone.
        counts: Output, number of surfaces in each column that are not steep and have the free space.
    """
    column = wp.tid()
    at = points[column]
    z, above, count = wp.float32(top), wp.float32(top + height), wp.int32(0)
    for _ in range(_SURFACES):
        query = wp.mesh_query_ray(mesh, wp.vec3(at[0], at[1], z), wp.vec3(0.0, 0.0, -1.0), z - bottom)
        if not query.result:
            break
        z = z - query.t
        if wp.abs(query.normal[2]) >= least_up and above - z >= height:
            if count < heights.shape[1]:
                heights[column, count] = z
            count += 1
        above = z
        z = z - _SKIN
    counts[column] = count


@wp.func
def _segment_distance_sq(a: wp.vec2, b: wp.vec2) -> float:
    """Squared distance of the origin from a segment in the plane [m^2]."""
    ab = b - a
    length_sq = wp.dot(ab, ab)
    t = wp.float32(0.0)
    if length_sq > 0.0:
        t = wp.clamp(-wp.dot(a, ab) / length_sq, 0.0, 1.0)
    p = a + t * ab
    return wp.dot(p, p)


@wp.func
def _clipped_edge_distance_sq(a: wp.vec3, b: wp.vec3, low: float, high: float) -> float:
    """Squared distance of the z axis from the part of an edge between two heights [m^2]; huge if there is none."""
    if wp.max(a[2], b[2]) < low or wp.min(a[2], b[2]) > high:
        return 1.0e30
    start, end = wp.float32(0.0), wp.float32(1.0)
    rise = b[2] - a[2]
    if wp.abs(rise) > 1.0e-12:
        first, last = (low - a[2]) / rise, (high - a[2]) / rise
        start, end = wp.max(start, wp.min(first, last)), wp.min(end, wp.max(first, last))
    p, q = a + start * (b - a), a + end * (b - a)
    return _segment_distance_sq(wp.vec2(p[0], p[1]), wp.vec2(q[0], q[1]))


@wp.func
def _cut_distance_sq(a: wp.vec3, b: wp.vec3, c: wp.vec3, level: float) -> float:
    """Squared distance of the z axis from the line in which a triangle meets a height [m^2]; huge if it does not."""
    first, second, found = wp.vec2(0.0, 0.0), wp.vec2(0.0, 0.0), wp.int32(0)
    for edge in range(3):
        p, q = a, b
        if edge == 1:
            p, q = b, c
        elif edge == 2:
            p, q = c, a
        if (p[2] - level) * (q[2] - level) < 0.0:
            hit = p + ((level - p[2]) / (q[2] - p[2])) * (q - p)
            if found == 0:
                first = wp.vec2(hit[0], hit[1])
            second = wp.vec2(hit[0], hit[1])
            found += 1
    if found < 2:  # a triangle that touches the height with a corner or an edge: its edges are looked at anyway
        return 1.0e30
    return _segment_distance_sq(first, second)


@wp.func
def _triangle_distance_sq(a: wp.vec3, b: wp.vec3, c: wp.vec3, low: float, high: float) -> float:
    """Squared distance of the z axis from the part of a triangle between two heights [m^2]; huge if there is none.

    That part is a convex polygon. Its edges are those of the triangle, as far as they lie between the heights, and the
    lines in which the triangle meets the two heights. The axis goes through the polygon, or one of these is nearest.
    """
    least = wp.min(_clipped_edge_distance_sq(a, b, low, high), _clipped_edge_distance_sq(b, c, low, high))
    least = wp.min(least, _clipped_edge_distance_sq(c, a, low, high))
    least = wp.min(least, wp.min(_cut_distance_sq(a, b, c, low), _cut_distance_sq(a, b, c, high)))
    # Signed areas of the triangles that the axis makes with the edges, as seen from above.
    u, v, w = b[0] * c[1] - b[1] * c[0], c[0] * a[1] - c[1] * a[0], a[0] * b[1] - a[1] * b[0]
    area = u + v + w
    same_side = wp.min(u, wp.min(v, w)) >= 0.0 or wp.max(u, wp.max(v, w)) <= 0.0
    if same_side and wp.abs(area) > 1.0e-12:
        z = (u * a[2] + v * b[2] + w * c[2]) / area
        if z >= low and z <= high:
            least = 0.0
    return least


@wp.func
def _is_obstructed(mesh: wp.uint64, at: wp.vec3, radius: float, low: float, high: float) -> bool:
    """Whether a triangle reaches into the upright cylinder over a point, between two heights above it [m]."""
    corner = wp.vec3(radius, radius, 0.0)
    lower, upper = at + wp.vec3(0.0, 0.0, low), at + wp.vec3(0.0, 0.0, high)
    query = wp.mesh_query_aabb(mesh, lower - corner, upper + corner)
    face = wp.int32(0)
    while wp.mesh_query_next(query, face):
        a = wp.mesh_get_point(mesh, 3 * face) - at
        b = wp.mesh_get_point(mesh, 3 * face + 1) - at
        c = wp.mesh_get_point(mesh, 3 * face + 2) - at
        if _triangle_distance_sq(a, b, c, low, high) < radius * radius:
            return True
    return False


@wp.func
def _is_level(mesh: wp.uint64, at: wp.vec3, radius: float, tolerance: float) -> bool:
    """Whether rays on rings around a point find ground, at its height up to a tolerance [m]."""
    rings = int(wp.ceil(radius / _RAY_SPACING))
    for ring in range(rings + 1):
        r = radius * float(ring) / wp.max(float(rings), 1.0)
        rays = wp.max(int(wp.ceil(2.0 * wp.pi * r / _RAY_SPACING)), 1)
        for i in range(rays):
            angle = 2.0 * wp.pi * float(i) / float(rays)
            start = at + wp.vec3(r * wp.cos(angle), r * wp.sin(angle), tolerance + _SKIN)
            query = wp.mesh_query_ray(mesh, start, wp.vec3(0.0, 0.0, -1.0), 2.0 * (tolerance + _SKIN))
            if not query.result:
                return False
    return True


@wp.kernel(enable_backward=False)
def check_spots(
    mesh: wp.uint64,
    points: wp.array[wp.vec3],
    radius: float,
    low: float,
    high: float,
    tolerance: float,
    verdict: wp.array[int],
):
    """Check the room of a robot at points of the ground.

    Args:
        mesh: Id of the mesh, made with ``support_winding_number``.
        points: Points on a surface [m], shape ``(points,)``.
        radius: Radius of the cylinder that must be free [m].
        low: Its lower end above the point [m].
        high: Its upper end above the point [m].
        tolerance: Height by which the ground below it may differ [m]; negative to accept any ground.
        verdict: Output, one of the constants of this module, shape ``(points,)``.
    """
    i = wp.tid()
    at = points[i]
    verdict[i] = CLEAR
    if _is_obstructed(mesh, at, radius, low, high):
        verdict[i] = OBSTRUCTED
        return
    # A solid that is larger than the robot has no surface in the cylinder: only its winding number tells.
    middle = at + wp.vec3(0.0, 0.0, 0.5 * (low + high))
    nearest = wp.mesh_query_point_sign_winding_number(mesh, middle, 1.0e6, 2.0, 0.5)
    if nearest.result and nearest.sign < 0.0:
        verdict[i] = INSIDE
        return
    if tolerance >= 0.0 and not _is_level(mesh, at, radius, tolerance):
        verdict[i] = UNEVEN
