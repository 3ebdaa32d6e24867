# SPDX-License-Identifier: Apache-2.0
"""The drift of a ray caster: errors of its position that last for an episode."""

import warp as wp

from ..mdp.random import uniform_vec3
from .ray import RaySetup

__all__ = ["reset_rays"]


@wp.kernel(enable_backward=False)
def reset_rays(mask: wp.array[wp.bool], bounds: wp.array[wp.vec2], setup: RaySetup, rng: wp.array[wp.uint32]):
    """Draw the drift of an episode that begins.

    Args:
        mask: Environments.
        bounds: Of the body's drift along x, y and z, and of the rays' [m].
        setup: The sensor.
        rng: Its random streams.
    """
    env = wp.tid()
    if mask[env]:
        setup.drift[env] = uniform_vec3(env, rng, bounds, 0)
        setup.ray_drift[env] = uniform_vec3(env, rng, bounds, 3)
