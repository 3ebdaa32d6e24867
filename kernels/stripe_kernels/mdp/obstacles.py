# SPDX-License-Identifier: Apache-2.0
"""Obstacle terms: observations and a termination of a robot among obstacles; see :mod:`stripe_kernels.obstacles`."""

from typing import TYPE_CHECKING

import warp as wp

from ..obstacles import ObstacleData, nearest_on_axis
from ..removed_tables import forward_tables
from ..sensors.ray import RayCasterData
from ..term_info import Each, writes
from .frames import rotate_inverse_yaw, yaw_of

__all__ = [
    "height_scan_over",
    "obstacle_distance",
    "obstacle_proximity",
    "obstacle_too_close",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, sizes={"OBSTACLE_OBSERVATION_SIZES": __name__})


@writes(Each("num_slots", 4))
@wp.func
def obstacle_distance(env: int, obstacles: ObstacleData, out: wp.array[float]):
    """Nearest points of the nearest obstacles and their distances, nearest first: four numbers for each slot.

    The first three are the nearest point of the surface relative to the root, in the frame of its yaw [m]; the fourth
    is its distance, negative if the root is inside [m]. A slot without an obstacle holds ``0, 0, 0, sight``.

    Formula: ``Rz(yaw)^T (a - p) d / |a - p|`` and ``d = |a - p| - r`` [m], ``a`` the nearest point of the axis, ``p``
    the root, ``r`` the radius.

    Source: this project.
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
            if away > 0.0:  # on the axis the direction is undefined, and the point stays at the root
                point = rotate_inverse_yaw(wp.transform_get_rotation(pose), to_axis * (distance / away))
        for axis in range(3):
            out[4 * slot + axis] = point[axis]
        out[4 * slot + 3] = distance


@wp.func
def obstacle_too_close(env: int, obstacles: ObstacleData, threshold: float) -> bool:
    """Termination if the surface of an obstacle is nearer to the root than ``threshold`` [m], at most ``sight``.

    Formula: ``d_0 < threshold``, ``d_0`` the distance of the nearest one [m].

    Source: this project.
    """
    return obstacles.distance[env, 0] < threshold


@wp.func
def _ray_to_outline(origin: wp.vec2, direction: wp.vec2, a: wp.vec2, b: wp.vec2, radius: float) -> float:
    """Length of a ray in the plane up to the outline of a capsule, the points within ``radius`` of ``a`` to ``b`` [m].

    0 for an origin inside, 1e30 for a ray that misses.
    """
    # First the circles about both ends, then the two long sides.
    found = wp.float32(1.0e30)
    for end in range(2):
        to = a - origin
        if end == 1:
            to = b - origin
        ahead, outside = wp.dot(to, direction), wp.dot(to, to) - radius * radius
        inner = ahead * ahead - outside
        if outside <= 0.0:
            found = 0.0
        elif ahead > 0.0 and inner >= 0.0:
            found = wp.min(found, ahead - wp.sqrt(inner))
    length = wp.length(b - a)
    if length > 1.0e-6:  # an upright stem is a circle, seen from above
        along = (b - a) / length
        across = wp.vec2(-along[1], along[0])
        beside, turn = wp.dot(origin - a, across), wp.dot(direction, across)
        way = wp.float32(0.0)
        if wp.abs(beside) > radius:
            way = -1.0
            if beside * turn < 0.0:
                way = (wp.abs(beside) - radius) / wp.abs(turn)
        if way >= 0.0:
            place = wp.dot(origin + way * direction - a, along)
            if place >= 0.0 and place <= length:
                found = wp.min(found, way)
    return found


@writes(Each("direction_ids"))
@wp.func
def obstacle_proximity(
    env: int, obstacles: ObstacleData, direction_ids: wp.array[int], below: float, out: wp.array[float]
):
    """Proximity of obstacles in each direction around the root, from 0 to 1; straight ahead first, counterclockwise.

    Rays lie in the horizontal plane and end at the outlines of obstacles seen from above. Outlines are widened by the
    spacing of the rays at their distance, so that no thin stem slips between two rays. Obstacles whose top is more than
    ``below`` [m] lower than the root are ignored, since the robot can step onto them.

    Formula: ``max(0, 1 - d / sight)``, ``d`` the length of the ray [m], with radii ``r + max(s, 0) tan(pi / n)``, ``s``
    the distance of the obstacle [m], ``n`` the number of directions; 0 where nothing is in sight.

    Source: this project.
    """
    pose = obstacles.root_pose[env]
    root = wp.transform_get_translation(pose)
    heading, origin = yaw_of(wp.transform_get_rotation(pose)), wp.vec2(root[0], root[1])
    wider = wp.tan(wp.pi / float(obstacles.directions))
    for k in range(direction_ids.shape[0]):
        angle = heading + 2.0 * wp.pi * float(direction_ids[k]) / float(obstacles.directions)
        direction, near = wp.vec2(wp.cos(angle), wp.sin(angle)), wp.float32(0.0)
        for slot in range(obstacles.found[env]):
            low, high = obstacles.low[env, slot], obstacles.high[env, slot]
            if high[3] > root[2] - below:
                radius = low[3] + wp.max(obstacles.distance[env, slot], 0.0) * wider
                way = _ray_to_outline(origin, direction, wp.vec2(low[0], low[1]), wp.vec2(high[0], high[1]), radius)
                near = wp.max(near, 1.0 - way / obstacles.sight)  # 1e30 of a miss leaves 0
        out[k] = near


@wp.func
def _top_height(point: wp.vec2, low: wp.vec4, high: wp.vec4) -> float:
    """Height of a capsule's top over a point of the plane [m]; -1e30 beside the capsule.

    The spheres about ``a + t (b - a)`` have their tops at ``a.z + t d.z + sqrt(R^2 - H^2 (t - t_0)^2)``, with ``H`` the
    length of the axis seen from above, ``t_0`` where it passes the point, ``R^2`` the radius squared less the distance
    squared; that is concave in ``t``.
    """
    to = point - wp.vec2(low[0], low[1])
    axis, rise, radius = wp.vec2(high[0] - low[0], high[1] - low[1]), high[2] - low[2], low[3]
    flat = wp.dot(axis, axis)
    if flat < 1.0e-10:  # upright: the formula would divide by zero
        outside = radius * radius - wp.dot(to, to)
        if outside < 0.0:
            return -1.0e30
        return wp.max(low[2], high[2]) + wp.sqrt(outside)
    middle = wp.dot(to, axis) / flat
    inside = radius * radius - wp.dot(to, to) + middle * middle * flat
    if inside < 0.0:
        return -1.0e30
    span = wp.sqrt(inside / flat)
    first, last = wp.max(middle - span, 0.0), wp.min(middle + span, 1.0)
    if first > last:
        return -1.0e30
    # Where the derivative of the height vanishes; clamping is right because the height is concave in ``t``.
    t = wp.clamp(middle + span * rise / wp.sqrt(flat + rise * rise), first, last)
    return low[2] + t * rise + wp.sqrt(wp.max(inside - flat * (t - middle) * (t - middle), 0.0))


@writes(Each("ray_ids"))
@wp.func
def height_scan_over(
    env: int,
    sensor: RayCasterData,
    obstacles: ObstacleData,
    ray_ids: wp.array[int],
    out: wp.array[float],
    offset: float = 0.5,
):
    """Height scan over ground and obstacles: ``height_scan`` of a sensor with vertical rays, raised by the obstacles.

    Formula: ``out_i = p.z - max(hit_i.z, top_i) - offset`` [m], ``top_i`` the highest point of an obstacle over
    or below the point that the ray hits.

    Source: this project, after Isaac Lab's ``mdp.height_scan``.
    """
    found = obstacles.found[env]
    for i in range(ray_ids.shape[0]):
        hit = sensor.ray_hits_w[env, ray_ids[i]]
        height = hit[2]
        for slot in range(found):
            top = _top_height(wp.vec2(hit[0], hit[1]), obstacles.low[env, slot], obstacles.high[env, slot])
            height = wp.max(height, top)
        out[i] = sensor.pos_w[env][2] - height - offset
