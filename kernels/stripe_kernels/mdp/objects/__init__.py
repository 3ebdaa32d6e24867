# SPDX-License-Identifier: Apache-2.0
"""Object pools: a pool of rigid objects in each environment, and the terms for them.

All bodies of a pool exist from the start. Those that are not *active* wait at rest in a parking place where they touch
nothing, and terms ignore them. To spawn or retire an object means to write its pose, its velocity and a flag in one
environment.

A slot is the index of an object in its pool. Linear velocities are those of the centre of mass, distances are between
link origins. ``pool`` holds the state and functions that terms call; ``events``, ``observations``, ``rewards`` and
``terminations`` hold one kind of term each.
"""

from typing import TYPE_CHECKING

from ...removed_tables import forward_tables
from . import events, observations, pool, rewards, terminations
from .events import (
    reset_object_targets,
    retire_objects,
    retire_objects_out_of_bounds,
    sample_object_targets,
    spawn_objects,
    spawn_objects_at_home,
    spawn_objects_in_region,
)
from .observations import (
    nearest_object_pos_b,
    object_active,
    object_positions_b,
    object_target_positions_b,
    object_velocities_b,
)
from .pool import (
    ObjectPoolData,
    nearest_active_object,
    nearest_object,
    num_active_objects,
    object_is_active,
    object_position,
    object_target,
    park_object,
    pose_in_world,
    retire_object,
    spawn_object,
    update_objects,
)
from .rewards import (
    object_distance_tanh,
    object_ee_distance,
    object_lifted,
    object_moved_to_goal,
    object_velocity_toward_goal,
    reach_object,
)
from .terminations import object_out_of_bounds, object_reached_goal

__all__ = [
    "ObjectPoolData",
    "events",
    "nearest_active_object",
    "nearest_object",
    "nearest_object_pos_b",
    "num_active_objects",
    "object_active",
    "object_distance_tanh",
    "object_ee_distance",
    "object_is_active",
    "object_lifted",
    "object_moved_to_goal",
    "object_out_of_bounds",
    "object_position",
    "object_positions_b",
    "object_reached_goal",
    "object_target",
    "object_target_positions_b",
    "object_velocities_b",
    "object_velocity_toward_goal",
    "observations",
    "park_object",
    "pool",
    "pose_in_world",
    "reach_object",
    "reset_object_targets",
    "retire_object",
    "retire_objects",
    "retire_objects_out_of_bounds",
    "rewards",
    "sample_object_targets",
    "spawn_object",
    "spawn_objects",
    "spawn_objects_at_home",
    "spawn_objects_in_region",
    "terminations",
    "update_objects",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, sizes={"OBJECT_OBSERVATION_SIZES": f"{__name__}.observations"})
