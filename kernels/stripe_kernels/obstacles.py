# SPDX-License-Identifier: Apache-2.0
"""Obstacles: many static capsules, of which each robot collides with the few nearest to it.

A uniform grid of square cells in the plane lists the obstacles whose axis-aligned boxes touch each cell; see
C. Ericson, "Real-Time Collision Detection", 2005, sections 5.1.2 (segments) and 7.1 (grids). One kernel finds the
nearest obstacles of each world. Another one gives their poses and sizes to static geoms of MuJoCo Warp, the slots.
"""

import warp as wp

__all__ = [
    "PARKED_DEPTH",
    "PARKED_SIZE",
    "ObstacleData",
    "find_obstacles",
    "nearest_on_axis",
    "pose_slots",
]

PARKED_DEPTH = 1.0e4
"""Depth below the origin at which slots without an obstacle lie [m]."""
PARKED_SIZE = 0.1
"""Radius and half length of a slot without an obstacle [m]."""
_DEPTH, _SIZE = wp.constant(PARKED_DEPTH), wp.constant(PARKED_SIZE)


@wp.struct
class ObstacleData:
    """Obstacle data: capsules in the world, the grid that lists them, and the ones nearest to each robot."""

    pos: wp.array[wp.vec3]
    """Centres in the world [m], shape ``(capacity,)``."""
    rot: wp.array[wp.quat]
    """Orientations; the axis is z, shape ``(capacity,)``."""
    radius: wp.array[float]
    """Radii [m], shape ``(capacity,)``."""
    half_length: wp.array[float]
    """Half lengths of the axes, without the caps [m], shape ``(capacity,)``."""
    start: wp.array[int]
    """Start of each cell's list, row by row; the list of cell c ends where that of c + 1 starts."""
    listed: wp.array[int]
    """Indices of obstacles, list after list."""
    low_end: wp.array[wp.vec4]
    """First end of the axis and radius [m] of each entry of ``listed``, copied so that the search reads in order."""
    high_end: wp.array[wp.vec4]
    """Second end of the axis [m] of each entry, and ``4 c + 2 f + g``: the column ``c`` of its cell, and flags
    whether that is the first column, ``f``, and the first row, ``g``, that list the obstacle."""
    grid: wp.array[float]
    """World x and y of the grid's corner and the size of a cell [m], shape ``(3,)``."""
    grid_shape: wp.array[int]
    """Number of columns, along x, and rows, along y, shape ``(2,)``."""
    root_pose: wp.array[wp.transform]
    """Poses of the robots' roots in the world [m], the simulation's own memory, shape ``(num_envs,)``."""
    searched: wp.array[wp.vec3]
    """Positions of the roots when the nearest obstacles were last found [m], shape ``(num_envs,)``. NaN for worlds that
    must be searched again."""
    index: wp.array2d[int]
    """The nearest obstacles in sight, nearest first, -1 for none, shape ``(num_envs, slots)``."""
    distance: wp.array2d[float]
    """Distances from the root to the surfaces of the nearest obstacles [m], negative inside; ``sight`` for none, shape
    ``(num_envs, slots)``."""
    found: wp.array[int]
    """Number of obstacles that have a slot, shape ``(num_envs,)``."""
    low: wp.array2d[wp.vec4]
    """First ends of the axes of the obstacles found, and their radii [m], shape ``(num_envs, slots)``."""
    high: wp.array2d[wp.vec4]
    """Second ends of their axes, and the heights of their highest points [m], shape ``(num_envs, slots)``."""
    count: wp.array[int]
    """Number of obstacles in reach, with or without a slot, shape ``(num_envs,)``."""
    overflow: wp.array[wp.bool]
    """Whether more obstacles were in reach than there are slots, shape ``(num_envs,)``."""
    reach: float
    """Distance from the root within which every obstacle needs a slot [m]."""
    directions: int
    """Number of directions of ``obstacle_proximity``."""
    sight: float
    """Distance from the root within which obstacles are searched [m], at least ``reach``."""


@wp.func
def nearest_on_axis(obstacles: ObstacleData, i: int, point: wp.vec3) -> wp.vec3:
    """Point of the axis of obstacle ``i`` nearest to a point, both in the world [m]."""
    centre, half = obstacles.pos[i], obstacles.half_length[i]
    axis = wp.quat_rotate(obstacles.rot[i], wp.vec3(0.0, 0.0, 1.0))
    return centre + wp.clamp(wp.dot(point - centre, axis), -half, half) * axis


@wp.func
def _precedes_slot(obstacles: ObstacleData, env: int, slot: int, distance: float, i: int) -> bool:
    """Whether obstacle ``i`` is nearer than the one in a slot, or as near and of a lower index."""
    # The index decides between equal distances, so that the result does not depend on the order of the grid's lists.
    there = obstacles.distance[env, slot]
    return distance < there or (distance == there and i < obstacles.index[env, slot])


@wp.func
def _insert(obstacles: ObstacleData, env: int, count: int, distance: float, i: int):
    """Insert an obstacle into the sorted slots of an environment, after ``count`` others; the last one may drop out."""
    slots = obstacles.index.shape[1]
    place = wp.int32(wp.min(count, slots - 1))
    if count >= slots and not _precedes_slot(obstacles, env, place, distance, i):
        return
    while place > 0 and _precedes_slot(obstacles, env, wp.max(place - 1, 0), distance, i):
        obstacles.distance[env, place] = obstacles.distance[env, place - 1]
        obstacles.index[env, place] = obstacles.index[env, place - 1]
        place -= 1
    obstacles.distance[env, place] = distance
    obstacles.index[env, place] = i


@wp.func
def _distance_to_capsule(point: wp.vec3, low: wp.vec4, high: wp.vec4) -> float:
    """Distance from a point to the surface of a capsule [m], negative inside."""
    start = wp.vec3(low[0], low[1], low[2])
    axis = wp.vec3(high[0], high[1], high[2]) - start
    share = wp.clamp(wp.dot(point - start, axis) / wp.dot(axis, axis), 0.0, 1.0)
    return wp.length(point - start - share * axis) - low[3]


@wp.func
def _find_nearest(obstacles: ObstacleData, env: int) -> int:
    """Write the nearest obstacles of a world; returns how many are in reach."""
    slots, sight = obstacles.index.shape[1], obstacles.sight
    for slot in range(slots):
        obstacles.index[env, slot] = -1
        obstacles.distance[env, slot] = sight
    obstacles.found[env] = 0
    seen, count = wp.int32(0), wp.int32(0)
    root = wp.transform_get_translation(obstacles.root_pose[env])
    # The cell of a diverged root is undefined; its world has no obstacles until it is reset.
    if not (wp.isfinite(root[0]) and wp.isfinite(root[1]) and wp.isfinite(root[2])):
        return count
    columns, rows, size = obstacles.grid_shape[0], obstacles.grid_shape[1], obstacles.grid[2]
    x, y = root[0] - obstacles.grid[0], root[1] - obstacles.grid[1]
    # Clamped as floats, since a far root would overflow an integer. Beside the grid left exceeds right, or low high.
    left = int(wp.clamp(wp.floor((x - sight) / size), 0.0, float(columns)))
    right = int(wp.clamp(wp.floor((x + sight) / size), -1.0, float(columns - 1)))
    low = int(wp.clamp(wp.floor((y - sight) / size), 0.0, float(rows)))
    high = int(wp.clamp(wp.floor((y + sight) / size), -1.0, float(rows - 1)))
    if left > right:
        return count
    for row in range(low, high + 1):
        # The lists of neighbouring columns follow each other, so that one range of entries covers a row of cells.
        for entry in range(obstacles.start[row * columns + left], obstacles.start[row * columns + right + 1]):
            end = obstacles.high_end[entry]
            distance = _distance_to_capsule(root, obstacles.low_end[entry], end)
            # An obstacle that several cells list counts in the first one that the search visits.
            cell = int(end[3])
            met = (cell & 2) == 0 and (cell >> 2) != left  # listed in the column before
            met = met or ((cell & 1) == 0 and row != low)  # or in the row before
            if distance < sight and not met:
                _insert(obstacles, env, seen, distance, obstacles.listed[entry])
                seen += 1
                count += int(distance < obstacles.reach)
    obstacles.found[env] = wp.min(seen, slots)
    for slot in range(wp.min(seen, slots)):
        i = obstacles.index[env, slot]
        centre, radius = obstacles.pos[i], obstacles.radius[i]
        axis = obstacles.half_length[i] * wp.quat_rotate(obstacles.rot[i], wp.vec3(0.0, 0.0, 1.0))
        a, b = centre - axis, centre + axis
        obstacles.low[env, slot] = wp.vec4(a[0], a[1], a[2], radius)
        obstacles.high[env, slot] = wp.vec4(b[0], b[1], b[2], wp.max(a[2], b[2]) + radius)
    return count


@wp.kernel(enable_backward=False)
def find_obstacles(
    obstacles: ObstacleData,
    where: wp.array[wp.bool],
    everywhere: bool,
    seen: wp.array[int],
    reported: wp.array[int],
):
    """Find the obstacles nearest to the robot of each world; one thread a world.

    Worlds whose robot is where it was at the last search are left as they are.

    Args:
        obstacles: Obstacles, grid and robots; the nearest obstacles are written to it.
        where: Worlds to search, shape ``(num_envs,)``.
        everywhere: Whether to search all worlds, whatever ``where`` holds.
        seen: Largest number of obstacles in reach of a robot, of those that exceeded the slots, shape ``(1,)``.
        reported: The same number for the host, shape ``(1,)``, in pinned memory of the host.
    """
    env = wp.tid()
    if not (everywhere or where[env]):
        return
    root = wp.transform_get_translation(obstacles.root_pose[env])
    if root == obstacles.searched[env]:
        return
    obstacles.searched[env] = root
    slots = obstacles.index.shape[1]
    count = _find_nearest(obstacles, env)
    obstacles.count[env] = count
    obstacles.overflow[env] = count > slots
    if count > slots:
        # A write to the host's memory is slow, so only a new maximum gets there.
        before = wp.atomic_max(seen, 0, count)
        if count > before:
            wp.atomic_max(reported, 0, count)


@wp.kernel(enable_backward=False)
def pose_slots(
    obstacles: ObstacleData,
    slot_geom: wp.array[int],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    geom_size: wp.array2d[wp.vec3],
    geom_aabb: wp.array3d[wp.vec3],
    geom_rbound: wp.array2d[float],
):
    """Give the slots of each world the poses and sizes of the obstacles found; threads (world, slot).

    Args:
        obstacles: Obstacles, and the ones nearest to each robot.
        slot_geom: Geoms that are slots, shape ``(slots,)``.
        geom_xpos: Output, positions of the geoms of MuJoCo Warp [m], shape ``(num_envs, ngeom)``.
        geom_xmat: Output, their orientations.
        geom_size: Output, their radii and half lengths [m].
        geom_aabb: Output, centres and half extents of their boxes in their frames [m].
        geom_rbound: Output, radii of their bounding spheres [m].
    """
    env, slot = wp.tid()
    geom, i = slot_geom[slot], obstacles.index[env, slot]
    pos, rot, radius, half = wp.vec3(0.0, 0.0, -_DEPTH), wp.quat_identity(), wp.float32(_SIZE), wp.float32(_SIZE)
    if i >= 0:
        pos = obstacles.pos[i]
        rot = obstacles.rot[i]
        radius = obstacles.radius[i]
        half = obstacles.half_length[i]
    geom_xpos[env, geom] = pos
    geom_xmat[env, geom] = wp.quat_to_matrix(rot)
    geom_size[env, geom] = wp.vec3(radius, half, 0.0)
    geom_aabb[env, geom, 0] = wp.vec3(0.0)
    geom_aabb[env, geom, 1] = wp.vec3(radius, radius, radius + half)
    geom_rbound[env, geom] = radius + half
