# SPDX-License-Identifier: Apache-2.0
"""Push-ball terms: the place from which an object is pushed, and the reward for going there."""

import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_kernels.mdp.objects import ObjectPoolData, object_position, object_target

__all__ = ["behind_object", "robot_velocity_toward_push"]


@wp.func
def behind_object(env: int, pool: ObjectPoolData, slot: int, distance: float) -> wp.vec3:
    """Place from which an object is pushed to its target [m], at the object's height.

    Formula: ``p - distance d / |d|``, ``d`` the horizontal vector from the object to its target.
    """
    p = object_position(env, pool, slot)
    way = object_target(env, pool, slot) - p
    return p - distance * wp.normalize(wp.vec3(way[0], way[1], 0.0))


@wp.func
def robot_velocity_toward_push(env: int, pool: ObjectPoolData, robot: ArticulationData, distance: float) -> float:
    """Horizontal speed of the root toward the place from which the pool's first object is pushed.

    It is 0 where the object is not active, and where the root is at that place.

    Formula: ``v . d / |d|`` [m/s], ``d`` the horizontal vector from the root link to the place of ``behind_object``.

    Source: this project.
    """
    if not pool.active[env, 0]:
        return 0.0
    way = behind_object(env, pool, 0, distance) - wp.transform_get_translation(robot.root_pose[env])
    return wp.dot(wp.spatial_top(robot.root_vel[env]), wp.normalize(wp.vec3(way[0], way[1], 0.0)))
