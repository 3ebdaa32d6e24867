# SPDX-License-Identifier: Apache-2.0
"""Scenery: kernels that begin an episode in an imported world."""

import warp as wp

from .mdp import random

__all__ = ["draw_spots", "put_back"]


@wp.kernel(enable_backward=False)
def draw_spots(
    mask: wp.array[wp.bool], spots: wp.array[wp.vec3], rng: wp.array[wp.uint32], env_origin: wp.array[wp.vec3]
):
    """Move the origins of environments whose episode begins to places that are drawn with equal chance.

    Args:
        mask: Environments, shape ``(num_envs,)``.
        spots: Places in the world [m], shape ``(spots,)``.
        rng: Random streams, shape ``(num_envs,)``; advanced by one draw where an episode begins.
        env_origin: Origins in the world [m], shape ``(num_envs,)``.
    """
    env = wp.tid()
    if mask[env]:
        count = spots.shape[0]
        env_origin[env] = spots[wp.min(int(random.uniform(env, rng) * float(count)), count - 1)]


@wp.kernel(enable_backward=False)
def put_back(mask: wp.array[wp.bool], columns: wp.array[int], first: wp.array2d[float], state: wp.array2d[float]):
    """Put joints back to their initial values; threads (environment, number).

    Args:
        mask: Environments, shape ``(num_envs,)``.
        columns: Numbers of the joints that are put back, shape ``(n,)``.
        first: Initial values of all joints, shape ``(num_envs, numbers)``.
        state: Values of all joints, shape ``(num_envs, numbers)``.
    """
    env, i = wp.tid()
    if mask[env]:
        state[env, columns[i]] = first[env, columns[i]]
