# SPDX-License-Identifier: Apache-2.0
"""Ray caster drift: errors of the sensor's position that last for an episode."""

import warp as wp

from ..mdp.random import uniform_vec3
from .ray import RaySetup

__all__ = ["reset_rays"]


@wp.kernel(enable_backward=False)
def reset_rays(mask: wp.array[wp.bool], bounds: wp.array[wp.vec2], setup: RaySetup, rng: wp.array[wp.uint32]):
    """Draw the drift of a new episode; one thread an environment.

    Args:
        mask: Environments that start an episode, shape ``(num_envs,)``.
        bounds: Bounds of the body's drift along x, y and z, then of the rays' drift [m], shape ``(6,)``.
        setup: The sensor, whose drift is written.
        rng: Random streams of the sensor, advanced, shape ``(num_envs,)``.
    """
    env = wp.tid()
    if mask[env]:
        setup.drift[env] = uniform_vec3(env, rng, bounds, 0)
        setup.ray_drift[env] = uniform_vec3(env, rng, bounds, 3)
