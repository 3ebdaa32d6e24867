# SPDX-License-Identifier: Apache-2.0
"""Object pool: state of a pool of objects, and functions that spawn, retire and query objects."""

import warp as wp

from ...data import ArticulationData

__all__ = [
    "ObjectPoolData",
    "nearest_active_object",
    "nearest_object",
    "num_active_objects",
    "object_is_active",
    "object_position",
    "object_target",
    "park_object",
    "pose_in_world",
    "retire_object",
    "spawn_object",
    "update_objects",
]


@wp.struct
class ObjectPoolData:
    """State of a pool of rigid objects; poses in the world unless said otherwise."""

    pose: wp.array2d[wp.transform]
    """Poses of the link frames [m], shape ``(num_envs, num_objects)``; the memory of the simulation's state."""
    vel: wp.array2d[wp.spatial_vector]
    """Velocities of the centres of mass [m/s, rad/s], shape ``(num_envs, num_objects)``; memory of the state too."""
    active: wp.array2d[wp.bool]
    """Whether an object is active, shape ``(num_envs, num_objects)``."""
    age: wp.array2d[int]
    """Steps since an active object was spawned, shape ``(num_envs, num_objects)``."""
    written: wp.array2d[wp.bool]
    """Whether an object was spawned or retired since the last ``update_objects``, shape ``(num_envs, num_objects)``."""
    home_pose: wp.array2d[wp.transform]
    """Poses of the objects' configs, in the environment's frame [m], shape ``(num_envs, num_objects)``."""
    home_vel: wp.array2d[wp.spatial_vector]
    """Velocities of the objects' configs [m/s, rad/s], shape ``(num_envs, num_objects)``."""
    target_pose: wp.array2d[wp.transform]
    """Target poses of the objects, in the environment's frame [m], shape ``(num_envs, num_objects)``."""
    parking_pose: wp.array[wp.transform]
    """Parking poses of retired objects, in the environment's frame [m], shape ``(num_objects,)``."""
    env_origin: wp.array[wp.vec3]
    """Origins of the environments [m], shape ``(num_envs,)``."""


# -- queries


@wp.func
def object_is_active(env: int, pool: ObjectPoolData, slot: int) -> bool:
    """Whether a slot exists and its object is active."""
    if slot < 0 or slot >= pool.active.shape[1]:
        return False
    return pool.active[env, slot]


@wp.func
def num_active_objects(env: int, pool: ObjectPoolData) -> int:
    """Number of active objects."""
    count = wp.int32(0)
    for k in range(pool.active.shape[1]):
        if pool.active[env, k]:
            count += 1
    return count


@wp.func
def object_position(env: int, pool: ObjectPoolData, slot: int) -> wp.vec3:
    """Position of an object's link frame in the world [m]."""
    return wp.transform_get_translation(pool.pose[env, slot])


@wp.func
def object_target(env: int, pool: ObjectPoolData, slot: int) -> wp.vec3:
    """Target position of an object in the world [m]."""
    return wp.transform_get_translation(pool.target_pose[env, slot]) + pool.env_origin[env]


@wp.func
def pose_in_world(env: int, pool: ObjectPoolData, pose: wp.transform) -> wp.transform:
    """Pose in the world [m] of a pose in the environment's frame."""
    pos = wp.transform_get_translation(pose) + pool.env_origin[env]
    return wp.transform(pos, wp.transform_get_rotation(pose))


@wp.func
def nearest_object(env: int, pool: ObjectPoolData, point: wp.vec3) -> int:
    """Slot of the active object nearest to a point of the world [m]; -1 where none is active."""
    nearest = wp.int32(-1)
    least = wp.float32(wp.inf)
    for k in range(pool.active.shape[1]):
        distance = wp.length(object_position(env, pool, k) - point)
        if pool.active[env, k] and distance < least:
            least = distance
            nearest = k
    return nearest


@wp.func
def nearest_active_object(env: int, pool: ObjectPoolData, robot: ArticulationData) -> int:
    """Slot of the active object nearest to the root link; -1 where none is active."""
    return nearest_object(env, pool, wp.transform_get_translation(robot.root_pose[env]))


@wp.func
def spawn_object(env: int, pool: ObjectPoolData, slot: int, pose: wp.transform, vel: wp.spatial_vector):
    """Spawn an object at a pose in the world [m] with a velocity [m/s, rad/s]; an active object is moved.

    A slot that does not exist is ignored.
    """
    if slot >= 0 and slot < pool.active.shape[1]:
        pool.pose[env, slot] = pose
        pool.vel[env, slot] = vel
        pool.active[env, slot] = True
        pool.age[env, slot] = 0
        pool.written[env, slot] = True


@wp.func
def park_object(env: int, pool: ObjectPoolData, slot: int):
    """Move an object to its parking pose, at rest."""
    pool.pose[env, slot] = pose_in_world(env, pool, pool.parking_pose[slot])
    pool.vel[env, slot] = wp.spatial_vector()


@wp.func
def retire_object(env: int, pool: ObjectPoolData, slot: int):
    """Retire an object: move it to its parking pose, at rest, and make it inactive. A slot that does not exist is
    ignored."""
    if slot >= 0 and slot < pool.active.shape[1]:
        park_object(env, pool, slot)
        pool.active[env, slot] = False
        pool.age[env, slot] = 0
        pool.written[env, slot] = True


@wp.func
def update_objects(env: int, pool: ObjectPoolData, moved: wp.array[wp.bool]):
    """Update a pool once a step: count the age of active objects, and put retired ones back to their parking poses.

    ``moved`` is set where an object was spawned or retired since the last call.
    """
    # Retired objects are put back in every step, since physics lets them fall a little.
    for k in range(pool.active.shape[1]):
        written = wp.bool(pool.written[env, k])  # a copy, or the ``elif`` would read the array again, cleared by then
        if written:
            pool.written[env, k] = False
            moved[env] = True
        elif pool.active[env, k]:
            pool.age[env, k] = pool.age[env, k] + 1
        if not pool.active[env, k]:
            park_object(env, pool, k)
