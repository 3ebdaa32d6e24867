# SPDX-License-Identifier: Apache-2.0
"""Events that randomise what holds for a whole environment."""

import warp as wp

from ..model_data import SceneModelData
from ..term_info import randomizes
from .randomization import randomize

__all__ = ["randomize_physics_scene_gravity"]


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
    """Draw a new gravity for the environment, each component on its own.

    ``gravity_distribution_params`` holds the first parameters of the three components and the second ones. What is
    projected onto the robot, such as ``projected_gravity``, stays the direction that the scene was built with.

    Formula: ``g_k = op(g_default,k, draw_k)`` [m/s^2].

    Source: Isaac Lab, ``mdp.randomize_physics_scene_gravity``.
    """
    first = gravity_distribution_params[0]
    second = gravity_distribution_params[1]
    gravity = model.default_gravity[env, 0]
    for k in range(3):
        gravity[k] = randomize(env, rng, gravity[k], wp.vec2(first[k], second[k]), operation, distribution)
    model.gravity[env, 0] = gravity
