# SPDX-License-Identifier: Apache-2.0
"""Object observations: positions, velocities, targets and activity of the objects of a pool."""

from typing import TYPE_CHECKING

import warp as wp

from ...data import ArticulationData
from ...removed_tables import forward_tables
from ...term_info import Each, writes
from .pool import ObjectPoolData, nearest_active_object, object_position, object_target

__all__ = [
    "nearest_object_pos_b",
    "object_active",
    "object_positions_b",
    "object_target_positions_b",
    "object_velocities_b",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, sizes={"OBJECT_OBSERVATION_SIZES": __name__})


@wp.func
def _write_b(point: wp.vec3, active: bool, root: wp.transform, first: int, out: wp.array[float]):
    """Write a point of the world in the root's frame [m], or zeros if the object is not active."""
    p = wp.vec3()
    if active:
        p = wp.quat_rotate_inv(wp.transform_get_rotation(root), point - wp.transform_get_translation(root))
    for i in range(3):
        out[first + i] = p[i]


@writes(Each("num_objects", 3))
@wp.func
def object_positions_b(env: int, pool: ObjectPoolData, robot: ArticulationData, out: wp.array[float]):
    """Positions of the objects relative to the root link, in its frame; zeros for those that are not active.

    Formula: ``R^T (p_k - p)`` [m], three numbers an object.

    Source: this project.
    """
    for k in range(pool.active.shape[1]):
        _write_b(object_position(env, pool, k), pool.active[env, k], robot.root_pose[env], 3 * k, out)


@writes(Each("num_objects", 3))
@wp.func
def object_target_positions_b(env: int, pool: ObjectPoolData, robot: ArticulationData, out: wp.array[float]):
    """Target positions of the objects relative to the root link, in its frame; zeros for those that are not active.

    Formula: ``R^T (p*_k + origin - p)`` [m], three numbers an object.

    Source: this project.
    """
    for k in range(pool.active.shape[1]):
        _write_b(object_target(env, pool, k), pool.active[env, k], robot.root_pose[env], 3 * k, out)


@writes(Each("num_objects", 3))
@wp.func
def object_velocities_b(env: int, pool: ObjectPoolData, robot: ArticulationData, out: wp.array[float]):
    """Linear velocities of the objects in the world, in the root's axes; zeros for those that are not active.

    Formula: ``R^T v_k`` [m/s], three numbers an object.

    Source: this project.
    """
    # A pose at the origin, so that _write_b rotates the velocity and shifts nothing.
    axes = wp.transform(wp.vec3(), wp.transform_get_rotation(robot.root_pose[env]))
    for k in range(pool.active.shape[1]):
        _write_b(wp.spatial_top(pool.vel[env, k]), pool.active[env, k], axes, 3 * k, out)


@writes(Each("num_objects"))
@wp.func
def object_active(env: int, pool: ObjectPoolData, out: wp.array[float]):
    """Activity flag of each object.

    Formula: ``1`` where active, else ``0``, one number an object.

    Source: this project.
    """
    for k in range(pool.active.shape[1]):
        out[k] = wp.where(pool.active[env, k], 1.0, 0.0)


@writes(3)
@wp.func
def nearest_object_pos_b(env: int, pool: ObjectPoolData, robot: ArticulationData, out: wp.array[float]):
    """Position of the active object nearest to the root link, in its frame; zeros where none is active.

    Formula: ``R^T (p_n - p)`` [m], ``n = argmin_k |p_k - p|`` over the active.

    Source: this project.
    """
    slot = nearest_active_object(env, pool, robot)
    _write_b(object_position(env, pool, wp.max(slot, 0)), slot >= 0, robot.root_pose[env], 0, out)
