# SPDX-License-Identifier: Apache-2.0
"""Object terminations: an object left its bounds, or all objects reached their targets. NaN terminates no episode."""

import warp as wp

from .pool import ObjectPoolData, num_active_objects, object_position, object_target

__all__ = [
    "object_out_of_bounds",
    "object_reached_goal",
]


@wp.func
def object_out_of_bounds(env: int, pool: ObjectPoolData, lower: wp.vec3, upper: wp.vec3) -> bool:
    """Termination if an active object is outside a box around the environment's origin.

    Formula: ``any_k p_k - origin < lower or > upper`` [m] in x, y or z, over the active.

    Source: this project.
    """
    out = wp.bool(False)
    for k in range(pool.active.shape[1]):
        p = object_position(env, pool, k) - pool.env_origin[env]
        for i in range(3):
            out = out or (pool.active[env, k] and (p[i] < lower[i] or p[i] > upper[i]))
    return out


@wp.func
def object_reached_goal(env: int, pool: ObjectPoolData, threshold: float) -> bool:
    """Termination if there are active objects and all of them have reached their targets.

    Formula: ``all_k |p_k - p*_k - origin| < threshold`` [m] over the active.

    Source: this project; the comparison is that of Isaac Lab's lift task, ``mdp.object_reached_goal``.
    """
    reached = num_active_objects(env, pool) > 0
    for k in range(pool.active.shape[1]):
        if pool.active[env, k]:
            reached = reached and wp.length(object_position(env, pool, k) - object_target(env, pool, k)) < threshold
    return reached
