# SPDX-License-Identifier: Apache-2.0
"""Noise of depth cameras: errors that grow with the distance, lost pixels and steps of the depth."""

import warp as wp

from .corruption import uniform_at

__all__ = ["DepthNoise", "add_depth_noise"]


@wp.struct
class DepthNoise:
    """Noise of a depth camera, the same for all pixels."""

    std: wp.vec3
    """Coefficients of the standard deviation: constant [m], times depth [-], times depth squared [1/m]."""
    dropout: float
    """Share of the pixels that see nothing."""
    quantization: float
    """Step of the depth [m]; 0 for none."""


@wp.kernel(enable_backward=False)
def add_depth_noise(
    due: wp.array[wp.bool],
    noise: DepthNoise,
    first: wp.array[wp.uint32],
    depth: wp.array2d[float],
    noisy: wp.array2d[float],
):
    """Put noise on depths; threads (environment, pixel). Each pixel takes three random numbers, used or not.

    Formula: ``z' = z + (s0 + s1 z + s2 z^2) N(0, 1)``, rounded to a multiple of the step; infinite with the
    probability of a dropout, and where ``z`` is.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        noise: The noise.
        first: First random number of the measurement, shape ``(num_envs,)``.
        depth: Depths, infinite where nothing was seen [m], shape ``(num_envs, size)``.
        noisy: Output, noisy depths, infinite where nothing is seen [m], same shape.
    """
    env, i = wp.tid()
    if not due[env]:
        return
    z = depth[env, i]
    n = first[env] + wp.uint32(3 * i)
    if wp.isinf(z) or uniform_at(env, n) < noise.dropout:
        noisy[env, i] = wp.inf
        return
    u, v = uniform_at(env, n + wp.uint32(1)), uniform_at(env, n + wp.uint32(2))
    normal = wp.sqrt(-2.0 * wp.log(1.0 - u)) * wp.cos(2.0 * wp.pi * v)
    z += (noise.std[0] + z * (noise.std[1] + z * noise.std[2])) * normal
    if noise.quantization > 0.0:
        z = noise.quantization * wp.round(z / noise.quantization)
    noisy[env, i] = z
