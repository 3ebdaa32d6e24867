# SPDX-License-Identifier: Apache-2.0
"""Ray caster against shapes: rays through Newton's bounding volume hierarchy, and against a height field."""

import warp as wp
from newton._src.geometry.raycast import (  # private, since newton.intersect_ray makes a new kernel at each call
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
    """Shapes that rays may hit and the hierarchy of their bounds, in the form of ``newton.Model``."""

    tree: wp.uint64
    """Id of the hierarchy; it has a group for each environment, and a last one for shapes that all share."""
    roots: wp.array[int]
    """Roots of the groups, -1 where a group is empty, shape ``(num_envs + 1,)``."""
    leaves: wp.array[wp.uint32]
    """Shapes of the leaves."""
    pose: wp.array[wp.transform]
    """Poses of the shapes in the world [m], shape ``(num_shapes,)``."""
    kind: wp.array[int]
    """``newton.GeoType`` of the shapes, shape ``(num_shapes,)``."""
    scale: wp.array[wp.vec3]
    """Sizes of the shapes in the form of ``newton.Model.shape_scale`` [m], shape ``(num_shapes,)``."""
    source: wp.array[wp.uint64]
    """Ids of the shapes' meshes, 0 for shapes without, shape ``(num_shapes,)``."""


@wp.func
def nearest_shape(env: int, start: wp.vec3, direction: wp.vec3, limit: float, targets: RayTargets) -> float:
    """Distance along a ray to the nearest shape of its environment or of all [m]; -1 if none within ``limit``."""
    best, found = limit, wp.float32(-1.0)
    for group in range(2):
        root = targets.roots[wp.where(group == 0, env, targets.roots.shape[0] - 1)]
        if root < 0:
            continue
        query = wp.bvh_query_ray(targets.tree, start, direction, root)
        leaf = wp.int32(0)
        while wp.bvh_query_next(query, leaf, best):  # boxes farther away than the best hit are skipped
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
    """Cast rays against shapes, and a height field if there is one; one thread a ray."""
    env, ray = wp.tid()
    if not setup.due[env]:
        return
    start, direction = ray_in_world(env, ray, setup, data)
    ground = wp.float32(-1.0)
    if field.heights.shape[0] > 0:
        ground = march_field(field, start, direction, setup.max_distance)
    limit = wp.where(ground >= 0.0, ground, setup.max_distance)  # shapes behind the ground need no test
    nearest = nearest_shape(env, start, direction, limit, targets)
    write_ray(env, ray, start, direction, wp.where(nearest >= 0.0, nearest, ground), setup, data)
