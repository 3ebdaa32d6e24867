# SPDX-License-Identifier: Apache-2.0
"""Randomisation of the scene: events that change properties of a whole environment, such as gravity."""

from typing import TYPE_CHECKING

import warp as wp

from ..model_data import SceneModelData
from ..removed_tables import forward_tables
from ..term_info import randomizes
from .randomization import randomize

__all__ = ["randomize_physics_scene_gravity"]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, randomizations={"SCENE_RANDOMIZATIONS": __name__})


@randomizes(defaults={"distribution": "uniform"})
@wp.func
def randomize_physics_scene_gravity(
    env: int,
    model: SceneModelData,
    rng: wp.array[wp.uint32],
    gravity_distribution_params: wp.array[wp.vec3],
    operation: int,
    distribution: int,
):
    """Randomise gravity, each component on its own.

    ``gravity_distribution_params`` holds the first parameters of the three components, then the second ones. Terms such
    as ``projected_gravity`` go on to use the direction that the scene was built with.

    Formula: ``g_k = op(g_default,k, draw_k)`` [m/s^2].

    Source: Isaac Lab, ``mdp.randomize_physics_scene_gravity``.
    """
    first = gravity_distribution_params[0]
    second = gravity_distribution_params[1]
    gravity = model.default_gravity[env, 0]
    for k in range(3):
        gravity[k] = randomize(env, rng, gravity[k], wp.vec2(first[k], second[k]), operation, distribution)
    model.gravity[env, 0] = gravity
