# SPDX-License-Identifier: Apache-2.0
"""Rays from a body to shapes of any kind, by Newton's bounding volumes and intersections, and to a height field."""

import warp as wp
from newton._src.geometry.raycast import (  # of newton.intersect_ray, which makes a new kernel at each call
    map_ray_to_local,
    ray_intersect_mesh_no_normal,
    ray_intersect_shape_no_normal,
)

from .ray import RayCasterData, RaySetup, ray_in_world, write_ray
from .ray_field import RayField, march_field

__all__ = ["RayTargets", "cast_rays", "nearest_shape"]

_INACTIVE = wp.constant(wp.uint32(0xFFFFFFFF))


@wp.struct
class RayTargets:
    """Shapes that rays may hit, and the tree of their bounds, as ``newton.Model`` holds them."""

    tree: wp.uint64
    """The tree; a group for each environment, and one last for what all share."""
    roots: wp.array[int]
    """Roots of the groups, -1 where a group is empty."""
    leaves: wp.array[wp.uint32]
    """Shapes of the leaves."""
    pose: wp.array[wp.transform]
    """Poses of the shapes in the world [m]."""
    kind: wp.array[int]
    """Their ``newton.GeoType``."""
    scale: wp.array[wp.vec3]
    """Their sizes."""
    source: wp.array[wp.uint64]
    """Their meshes, 0 for those that have none."""


@wp.func
def nearest_shape(env: int, start: wp.vec3, direction: wp.vec3, limit: float, targets: RayTargets) -> float:
    """Distance along a ray to a shape of its environment or a shared one [m]; -1 if none is nearer than ``limit``."""
    best, found = limit, wp.float32(-1.0)
    for group in range(2):
        root = targets.roots[wp.where(group == 0, env, targets.roots.shape[0] - 1)]
        if root < 0:
            continue
        query = wp.bvh_query_ray(targets.tree, start, direction, root)
        leaf = wp.int32(0)
        while wp.bvh_query_next(query, leaf, best):
            entry = targets.leaves[leaf]
            if entry == _INACTIVE:
                continue
            shape = int(entry)
            pose = targets.pose[shape]
            scale = targets.scale[shape]
            mesh = targets.source[shape]
            distance = wp.float32(-1.0)
            if mesh != wp.uint64(0):
                local_start, local_direction = map_ray_to_local(pose, start, direction, scale)
                distance, _n, _u, _v, _f = ray_intersect_mesh_no_normal(
                    local_start, local_direction, scale, mesh, False, best
                )
            else:
                distance, _n = ray_intersect_shape_no_normal(pose, scale, targets.kind[shape], start, direction, False)
            if distance >= 0.0 and distance <= best:
                best, found = distance, distance
    return found


@wp.kernel(enable_backward=False)
def cast_rays(setup: RaySetup, field: RayField, targets: RayTargets, data: RayCasterData):
    """Cast rays against shapes, and a height field where there is one: one thread a ray."""
    env, ray = wp.tid()
    if not setup.due[env]:
        return
    start, direction = ray_in_world(env, ray, setup, data)
    ground = wp.float32(-1.0)
    if field.heights.shape[0] > 0:
        ground = march_field(field, start, direction, setup.max_distance)
    limit = wp.where(ground >= 0.0, ground, setup.max_distance)
    nearest = nearest_shape(env, start, direction, limit, targets)
    write_ray(env, ray, start, direction, wp.where(nearest >= 0.0, nearest, ground), setup, data)
