# SPDX-License-Identifier: Apache-2.0
"""Object rewards: reach, lift and move the objects of a pool."""

import warp as wp

from ...data import ArticulationData
from .pool import ObjectPoolData, nearest_object, num_active_objects, object_position, object_target

__all__ = [
    "object_distance_tanh",
    "object_ee_distance",
    "object_lifted",
    "object_moved_to_goal",
    "object_velocity_toward_goal",
    "reach_object",
]


@wp.func
def _distance_to_bodies(env: int, pool: ObjectPoolData, robot: ArticulationData, body_ids: wp.array[int]) -> float:
    """Smallest distance between a link and an active object [m]; infinite where none is active."""
    least = wp.float32(wp.inf)
    for i in range(body_ids.shape[0]):
        point = wp.transform_get_translation(robot.body_pose[env, body_ids[i]])
        slot = nearest_object(env, pool, point)
        if slot >= 0:
            least = wp.min(least, wp.length(object_position(env, pool, slot) - point))
    return least


@wp.func
def object_distance_tanh(env: int, pool: ObjectPoolData, robot: ArticulationData, std: float) -> float:
    """Closeness of the root link to the nearest active object, from 0 to 1; 0 where none is active.

    Formula: ``1 - tanh(min_k |p_k - p| / std)``, ``std`` [m].

    Source: this project; the kernel is that of Isaac Lab's lift task, ``mdp.object_ee_distance``.
    """
    point = wp.transform_get_translation(robot.root_pose[env])
    slot = nearest_object(env, pool, point)
    if slot < 0:
        return 0.0
    return 1.0 - wp.tanh(wp.length(object_position(env, pool, slot) - point) / std)


@wp.func
def object_ee_distance(
    env: int, pool: ObjectPoolData, robot: ArticulationData, body_ids: wp.array[int], std: float
) -> float:
    """Closeness of the nearest pair of a link and an active object, from 0 to 1; 0 where none is active.

    Formula: ``1 - tanh(min_ik |p_k - p_i| / std)``, ``std`` [m].

    Source: Isaac Lab's lift task, ``mdp.object_ee_distance``, there of one object and one frame.
    """
    return 1.0 - wp.tanh(_distance_to_bodies(env, pool, robot, body_ids) / std)


@wp.func
def reach_object(
    env: int, pool: ObjectPoolData, robot: ArticulationData, body_ids: wp.array[int], threshold: float
) -> float:
    """Reward of 1 while a link is within reach of an active object.

    Formula: ``1`` if ``min_ik |p_k - p_i| < threshold`` [m], else ``0``.

    Source: this project.
    """
    return wp.where(_distance_to_bodies(env, pool, robot, body_ids) < threshold, 1.0, 0.0)


@wp.func
def object_moved_to_goal(env: int, pool: ObjectPoolData, std: float) -> float:
    """Closeness of the active objects to their targets, from 0 to 1; 0 where none is active.

    Formula: mean over the active of ``1 - tanh(|p_k - p*_k - origin| / std)``, ``std`` [m].

    Source: this project; the kernel is that of Isaac Lab's lift task, ``mdp.object_goal_distance``.
    """
    total = wp.float32(0.0)
    for k in range(pool.active.shape[1]):
        if pool.active[env, k]:
            total += 1.0 - wp.tanh(wp.length(object_position(env, pool, k) - object_target(env, pool, k)) / std)
    return total / wp.float32(wp.max(num_active_objects(env, pool), 1))


@wp.func
def object_velocity_toward_goal(env: int, pool: ObjectPoolData) -> float:
    """Speed of the active objects toward their targets; 0 where none is active.

    Formula: mean over the active of ``v_k . d_k / |d_k|`` [m/s], ``d_k = p*_k + origin - p_k``; 0 where ``d_k = 0``.

    Source: this project.
    """
    total = wp.float32(0.0)
    for k in range(pool.active.shape[1]):
        if pool.active[env, k]:
            # wp.normalize returns zero for a zero vector: an object at its target adds nothing.
            way = wp.normalize(object_target(env, pool, k) - object_position(env, pool, k))
            total += wp.dot(wp.spatial_top(pool.vel[env, k]), way)
    return total / wp.float32(wp.max(num_active_objects(env, pool), 1))


@wp.func
def object_lifted(env: int, pool: ObjectPoolData, minimal_height: float) -> float:
    """Share of the active objects that are lifted above a height; 0 where none is active.

    Formula: mean over the active of ``1`` if ``p_k.z - origin.z > minimal_height`` [m], else ``0``.

    Source: Isaac Lab's lift task, ``mdp.object_is_lifted``, there of one object and in the world.
    """
    total = wp.float32(0.0)
    for k in range(pool.active.shape[1]):
        if pool.active[env, k] and object_position(env, pool, k)[2] - pool.env_origin[env][2] > minimal_height:
            total += 1.0
    return total / wp.float32(wp.max(num_active_objects(env, pool), 1))
