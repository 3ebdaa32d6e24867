# SPDX-License-Identifier: Apache-2.0
"""Object events: spawn and retire the objects of a pool, and draw their targets."""

import warp as wp

from ...data import ArticulationData
from .. import random
from .pool import ObjectPoolData, num_active_objects, object_position, pose_in_world, retire_object, spawn_object

__all__ = [
    "reset_object_targets",
    "retire_objects",
    "retire_objects_out_of_bounds",
    "sample_object_targets",
    "spawn_objects",
    "spawn_objects_at_home",
    "spawn_objects_in_region",
]


@wp.func
def retire_objects(env: int, pool: ObjectPoolData):
    """Retire all objects.

    Formula: ``active_k = 0``, ``p_k = parking_k + origin`` [m], ``v_k = 0``.

    Source: this project.
    """
    for k in range(pool.active.shape[1]):
        retire_object(env, pool, k)


@wp.func
def retire_objects_out_of_bounds(env: int, pool: ObjectPoolData, lower: wp.vec3, upper: wp.vec3):
    """Retire the active objects outside a box around the environment's origin, and those whose position is NaN.

    Formula: ``active_k = 0`` unless ``lower <= p_k - origin <= upper`` [m] in x, y and z.

    Source: this project.
    """
    for k in range(pool.active.shape[1]):
        if pool.active[env, k] and not _is_inside(object_position(env, pool, k) - pool.env_origin[env], lower, upper):
            retire_object(env, pool, k)


@wp.func
def _is_inside(p: wp.vec3, lower: wp.vec3, upper: wp.vec3) -> bool:
    """Whether a point is in a box; False for NaN."""
    x = p[0] >= lower[0] and p[0] <= upper[0]
    y = p[1] >= lower[1] and p[1] <= upper[1]
    z = p[2] >= lower[2] and p[2] <= upper[2]
    return x and y and z


@wp.func
def _draw_number(env: int, pool: ObjectPoolData, rng: wp.array[wp.uint32], num_range: wp.vec2) -> int:
    """Whole number from ``num_range[0]`` to ``num_range[1]``, at most the number of retired objects; one draw."""
    low = wp.int32(num_range[0])
    high = wp.int32(num_range[1])
    number = wp.min(low + wp.int32(random.uniform(env, rng) * wp.float32(high - low + 1)), high)
    return wp.min(number, pool.active.shape[1] - num_active_objects(env, pool))


@wp.func
def _draw_retired(env: int, pool: ObjectPoolData, rng: wp.array[wp.uint32]) -> int:
    """Slot of a random retired object, all with the same chance; -1 if there is none; one draw."""
    count = pool.active.shape[1] - num_active_objects(env, pool)
    wanted = wp.min(wp.int32(random.uniform(env, rng) * wp.float32(count)), count - 1)
    slot = wp.int32(-1)
    seen = wp.int32(0)
    for k in range(pool.active.shape[1]):
        if not pool.active[env, k]:
            if seen == wanted:
                slot = k
            seen += 1
    return slot


@wp.func
def spawn_objects_at_home(env: int, pool: ObjectPoolData, rng: wp.array[wp.uint32], num_range: wp.vec2):
    """Spawn some of the retired objects, chosen at random, at the poses of their configs.

    Formula: ``p_k = p_home,k + origin`` [m], ``q_k = q_home,k``, ``v_k = v_home,k`` [m/s, rad/s], for ``n`` of the
    retired, ``n`` whole and uniform over ``num_range``, both ends included.

    Source: this project.
    """
    for _i in range(_draw_number(env, pool, rng, num_range)):
        slot = _draw_retired(env, pool, rng)
        spawn_object(env, pool, slot, pose_in_world(env, pool, pool.home_pose[env, slot]), pool.home_vel[env, slot])


@wp.func
def _is_free(env: int, pool: ObjectPoolData, p: wp.vec3, min_distance: float, keep: wp.vec3, keep_off: float) -> bool:
    """Whether ``p`` is ``min_distance`` [m] from all active objects, and ``keep_off`` [m] from ``keep``, from above."""
    free = wp.length(wp.vec2(p[0] - keep[0], p[1] - keep[1])) >= keep_off
    for k in range(pool.active.shape[1]):
        if pool.active[env, k] and wp.length(object_position(env, pool, k) - p) < min_distance:
            free = False
    return free


@wp.func
def _spawn_apart(
    env: int,
    pool: ObjectPoolData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
    num_range: wp.vec2,
    min_distance: float,
    max_tries: int,
    keep: wp.vec3,
    keep_off: float,
):
    """Spawn retired objects apart from each other and, in the horizontal plane, ``keep_off`` [m] from ``keep``."""
    for _i in range(_draw_number(env, pool, rng, num_range)):
        slot = _draw_retired(env, pool, rng)
        home = pool.home_pose[env, slot]
        height = wp.vec3(0.0, 0.0, wp.transform_get_translation(home)[2])
        tries = wp.int32(0)
        while tries < max_tries:
            tries += 1
            pos = pool.env_origin[env] + height + random.uniform_vec3(env, rng, pose_range, 0)
            if _is_free(env, pool, pos, min_distance, keep, keep_off):
                tries = max_tries  # ends the loop
                angles = random.uniform_vec3(env, rng, pose_range, 3)
                rot = wp.transform_get_rotation(home) * wp.quat_rpy(angles[0], angles[1], angles[2])
                vel = pool.home_vel[env, slot] + random.uniform_twist(env, rng, velocity_range)
                spawn_object(env, pool, slot, wp.transform(pos, rot), vel)


@wp.func
def spawn_objects(
    env: int,
    pool: ObjectPoolData,
    robot: ArticulationData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
    num_range: wp.vec2,
    min_distance: float,
    min_robot_distance: float,
    max_tries: int,
):
    """Spawn some of the retired objects, chosen at random, in a region, apart from each other and from the robot.

    Formula: ``p_k = origin + (0, 0, p_home,k.z) + U`` [m], ``q_k = q_home,k Rz(U) Ry(U) Rx(U)``, ``v_k = v_home,k + U``
    [m/s, rad/s], for ``n`` of the retired, ``n`` whole and uniform over ``num_range``, both ends included. ``p_k`` is
    drawn up to ``max_tries`` times until it is ``min_distance`` from all active objects, and ``min_robot_distance``
    from the root in the horizontal plane [m]; an object that finds no place stays retired.

    Source: this project.
    """
    root = wp.transform_get_translation(robot.root_pose[env])
    _spawn_apart(
        env, pool, rng, pose_range, velocity_range, num_range, min_distance, max_tries, root, min_robot_distance
    )


@wp.func
def spawn_objects_in_region(
    env: int,
    pool: ObjectPoolData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
    num_range: wp.vec2,
    min_distance: float,
    max_tries: int,
):
    """Spawn some of the retired objects, chosen at random, in a region, apart from each other.

    Formula: as of ``spawn_objects``, without a robot to keep away from.

    Source: this project.
    """
    _spawn_apart(env, pool, rng, pose_range, velocity_range, num_range, min_distance, max_tries, wp.vec3(), 0.0)


@wp.func
def sample_object_targets(env: int, pool: ObjectPoolData, rng: wp.array[wp.uint32], pose_range: wp.array[wp.vec2]):
    """Draw target poses of the objects.

    Formula: ``p*_k = (0, 0, p_home,k.z) + U`` [m], ``q*_k = q_home,k Rz(U) Ry(U) Rx(U)``, in the environment's frame.

    Source: this project.
    """
    for k in range(pool.active.shape[1]):
        home = pool.home_pose[env, k]
        pos = random.uniform_vec3(env, rng, pose_range, 0)
        angles = random.uniform_vec3(env, rng, pose_range, 3)
        pos = pos + wp.vec3(0.0, 0.0, wp.transform_get_translation(home)[2])
        rot = wp.transform_get_rotation(home) * wp.quat_rpy(angles[0], angles[1], angles[2])
        pool.target_pose[env, k] = wp.transform(pos, rot)


@wp.func
def reset_object_targets(env: int, pool: ObjectPoolData):
    """Reset the target poses of the objects to the poses of their configs.

    Formula: ``p*_k = p_home,k`` [m], ``q*_k = q_home,k``, in the environment's frame.

    Source: this project.
    """
    for k in range(pool.active.shape[1]):
        pool.target_pose[env, k] = pool.home_pose[env, k]
