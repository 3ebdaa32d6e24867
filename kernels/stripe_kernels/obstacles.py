# SPDX-License-Identifier: Apache-2.0
"""Many capsules that stand in the world, of which each robot touches the few that are nearest to it.

A uniform grid of square cells in the plane lists the obstacles whose axis-aligned boxes touch each cell; see
C. Ericson, "Real-Time Collision Detection", 2005, sections 5.1.2 (segments) and 7.1 (grids). One kernel finds the
nearest of each world and gives their poses and sizes to as many static geoms of MuJoCo Warp, the slots.
"""

from collections.abc import Callable, Mapping

import warp as wp

from .mdp.frames import rotate_inverse_yaw

__all__ = [
    "OBSTACLE_OBSERVATION_SIZES",
    "PARKED_DEPTH",
    "PARKED_SIZE",
    "ObstacleData",
    "nearest_on_axis",
    "obstacle_distance",
    "pose_slots",
    "too_close",
]

PARKED_DEPTH = 1.0e4
"""How far below the origin slots lie that hold no obstacle [m]."""
PARKED_SIZE = 0.1
"""Radius and half length of such a slot [m]."""
_DEPTH, _SIZE = wp.constant(PARKED_DEPTH), wp.constant(PARKED_SIZE)

OBSTACLE_OBSERVATION_SIZES: dict[str, Callable[[Mapping[str, int]], int]] = {
    "obstacle_distance": lambda counts: 4 * counts["num_slots"],
}


@wp.struct
class ObstacleData:
    """Capsules in the world, the grid that lists them, and those that are nearest to each robot."""

    pos: wp.array[wp.vec3]
    """Centres in the world [m], shape ``(capacity,)``."""
    rot: wp.array[wp.quat]
    """Orientations; the axis is z, shape ``(capacity,)``."""
    radius: wp.array[float]
    """Radii [m], shape ``(capacity,)``."""
    half_length: wp.array[float]
    """Half lengths of the axes, without the caps [m], shape ``(capacity,)``."""
    first_cell: wp.array[wp.vec2i]
    """Column and row of the first cell that lists an obstacle, shape ``(capacity,)``."""
    start: wp.array[int]
    """Where the list of a cell starts, row by row; that of cell c ends where that of c + 1 starts."""
    listed: wp.array[int]
    """Indices of obstacles, list after list."""
    grid: wp.array[float]
    """World x and y of the grid's corner and the size of a cell [m], shape ``(3,)``."""
    grid_shape: wp.array[int]
    """Number of columns, along x, and rows, along y, shape ``(2,)``."""
    root_pose: wp.array[wp.transform]
    """Poses of the robots' roots, the simulation's own memory [m], shape ``(num_envs,)``."""
    index: wp.array2d[int]
    """The nearest obstacles in reach, nearest first, -1 for none, shape ``(num_envs, slots)``."""
    distance: wp.array2d[float]
    """From the root to their surfaces, negative inside [m]; ``reach`` for none, shape ``(num_envs, slots)``."""
    count: wp.array[int]
    """Obstacles in reach, those that have no slot included, shape ``(num_envs,)``."""
    overflow: wp.array[wp.bool]
    """Whether there were more than slots, shape ``(num_envs,)``."""
    reach: float
    """Distance from the root within which obstacles get slots [m]."""


@wp.func
def nearest_on_axis(obstacles: ObstacleData, i: int, point: wp.vec3) -> wp.vec3:
    """The point of the axis of obstacle ``i`` that is nearest to a point of the world [m]."""
    centre, half = obstacles.pos[i], obstacles.half_length[i]
    axis = wp.quat_rotate(obstacles.rot[i], wp.vec3(0.0, 0.0, 1.0))
    return centre + wp.clamp(wp.dot(point - centre, axis), -half, half) * axis


@wp.func
def _before(obstacles: ObstacleData, env: int, slot: int, distance: float, i: int) -> bool:
    """Whether obstacle ``i`` comes before the one in a slot; of two equally near ones the lower index does."""
    there = obstacles.distance[env, slot]
    return distance < there or (distance == there and i < obstacles.index[env, slot])


@wp.func
def _keep(obstacles: ObstacleData, env: int, count: int, distance: float, i: int):
    """Sort an obstacle into those that are kept, ``count`` others having been found before."""
    slots = obstacles.index.shape[1]
    place = wp.int32(wp.min(count, slots - 1))
    if count >= slots and not _before(obstacles, env, place, distance, i):
        return
    while place > 0 and _before(obstacles, env, wp.max(place - 1, 0), distance, i):
        obstacles.distance[env, place] = obstacles.distance[env, place - 1]
        obstacles.index[env, place] = obstacles.index[env, place - 1]
        place -= 1
    obstacles.distance[env, place] = distance
    obstacles.index[env, place] = i


@wp.func
def _find(obstacles: ObstacleData, env: int) -> int:
    """Write the nearest obstacles of a world; how many are in reach."""
    slots, reach = obstacles.index.shape[1], obstacles.reach
    for slot in range(slots):
        obstacles.index[env, slot] = -1
        obstacles.distance[env, slot] = reach
    count = wp.int32(0)
    root = wp.transform_get_translation(obstacles.root_pose[env])
    if not (wp.isfinite(root[0]) and wp.isfinite(root[1]) and wp.isfinite(root[2])):
        return count
    columns, rows, size = obstacles.grid_shape[0], obstacles.grid_shape[1], obstacles.grid[2]
    x, y = root[0] - obstacles.grid[0], root[1] - obstacles.grid[1]
    left = int(wp.clamp(wp.floor((x - reach) / size), 0.0, float(columns)))
    right = int(wp.clamp(wp.floor((x + reach) / size), -1.0, float(columns - 1)))
    low = int(wp.clamp(wp.floor((y - reach) / size), 0.0, float(rows)))
    high = int(wp.clamp(wp.floor((y + reach) / size), -1.0, float(rows - 1)))
    for row in range(low, high + 1):
        for column in range(left, right + 1):
            cell = row * columns + column
            for entry in range(obstacles.start[cell], obstacles.start[cell + 1]):
                i = obstacles.listed[entry]
                first = obstacles.first_cell[i]
                if column == wp.max(first[0], left) and row == wp.max(first[1], low):  # else it was met before
                    distance = wp.length(root - nearest_on_axis(obstacles, i, root)) - obstacles.radius[i]
                    if distance < reach:
                        _keep(obstacles, env, count, distance, i)
                        count += 1
    return count


@wp.kernel(enable_backward=False)
def pose_slots(
    obstacles: ObstacleData,
    slot_geom: wp.array[int],
    seen: wp.array[int],
    told: wp.array[int],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    geom_size: wp.array2d[wp.vec3],
    geom_aabb: wp.array3d[wp.vec3],
    geom_rbound: wp.array2d[float],
):
    """Find the obstacles that are nearest to the robot of each world and put its slots in their places.

    Args:
        obstacles: Obstacles, grid and robots; what was found is written to it.
        slot_geom: Geoms that are slots, shape ``(slots,)``.
        seen: Most obstacles in reach of a robot that were ever more than slots, shape ``(1,)``.
        told: The same where it is news, memory that the host reads, shape ``(1,)``.
        geom_xpos: Output, positions of the geoms of MuJoCo Warp [m], shape ``(num_envs, ngeom)``.
        geom_xmat: Output, their orientations.
        geom_size: Output, their radii and half lengths [m].
        geom_aabb: Output, centres and half extents of their boxes in their frames [m].
        geom_rbound: Output, radii of their bounding spheres [m].
    """
    env = wp.tid()
    slots = slot_geom.shape[0]
    count = _find(obstacles, env)
    obstacles.count[env] = count
    obstacles.overflow[env] = count > slots
    if count > slots:
        before = wp.atomic_max(seen, 0, count)
        if count > before:
            wp.atomic_max(told, 0, count)
    for slot in range(slots):
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


@wp.func
def obstacle_distance(env: int, obstacles: ObstacleData, out: wp.array[float]):
    """Where the surfaces of the nearest obstacles are, nearest first: four numbers for each slot.

    The first three are the nearest point of the surface relative to the root, in the frame of its yaw [m]; the fourth
    is its distance, negative if the root is inside [m]. With ``a`` the nearest point of the axis, ``p`` the root and
    ``r`` the radius: ``d = |a - p| - r``, point ``(a - p) d / |a - p|``. A slot without an obstacle reads
    ``0, 0, 0, reach``.
    """
    pose = obstacles.root_pose[env]
    root = wp.transform_get_translation(pose)
    for slot in range(obstacles.index.shape[1]):
        i, point = obstacles.index[env, slot], wp.vec3(0.0)
        distance = obstacles.distance[env, slot]
        if i >= 0:
            to_axis = nearest_on_axis(obstacles, i, root) - root
            away = wp.length(to_axis)
            distance = away - obstacles.radius[i]
            if away > 0.0:
                point = rotate_inverse_yaw(wp.transform_get_rotation(pose), to_axis * (distance / away))
        for axis in range(3):
            out[4 * slot + axis] = point[axis]
        out[4 * slot + 3] = distance


@wp.func
def too_close(env: int, obstacles: ObstacleData, threshold: float) -> bool:
    """Whether the surface of an obstacle is nearer to the root than ``threshold`` [m], at most ``reach``."""
    return obstacles.distance[env, 0] < threshold
