# SPDX-License-Identifier: Apache-2.0
"""Random draws, one stream for each environment.

``rng`` holds one number an environment, shape ``(num_envs,)``, which every draw advances in place. The stream of an
environment depends on the seed and on its index, not on how many others there are, nor on how the draws are split over
launches.

A draw hashes the number together with the index. Environments whose numbers meet, which among thousands of streams
over 2^32 numbers does happen, therefore do not go on in step, as they would if the number itself were the draw.
"""

import warp as wp

__all__ = [
    "bernoulli",
    "draw",
    "gaussian",
    "normal",
    "random_quat",
    "seed_stream",
    "uniform",
    "uniform_range",
    "uniform_twist",
    "uniform_vec3",
]


@wp.func
def seed_stream(seed: int, env: int) -> wp.uint32:
    """The number at which the stream of environment ``env`` starts, for a ``seed``."""
    return wp.rand_init(seed, env)


@wp.func
def draw(env: int, rng: wp.array[wp.uint32]) -> wp.uint32:
    """32 random bits.

    Formula: ``h(env + h(n)); n <- n + 1``, ``h`` the hash PCG-RXS-M-XS.

    Source: M. Jarzynski and M. Olano, "Hash Functions for GPU Rendering", J. Computer Graphics Techniques 9(3), 2020.
    """
    n = rng[env]
    rng[env] = n + wp.uint32(1)
    return wp.rand_init(env, wp.int32(n))


@wp.func
def uniform(env: int, rng: wp.array[wp.uint32]) -> float:
    """A multiple of 2^-24, uniform in [0, 1)."""
    return wp.randf(draw(env, rng))


@wp.func
def uniform_range(env: int, rng: wp.array[wp.uint32], bounds: wp.vec2) -> float:
    """Uniform between ``bounds[0]`` and ``bounds[1]``; takes one draw even where they are equal."""
    u = uniform(env, rng)
    return bounds[0] + (bounds[1] - bounds[0]) * u


@wp.func
def bernoulli(env: int, rng: wp.array[wp.uint32], probability: float) -> bool:
    """True with this probability: never at 0, always at 1."""
    return uniform(env, rng) < probability


@wp.func
def normal(env: int, rng: wp.array[wp.uint32]) -> float:
    """Normal with mean 0 and standard deviation 1, at most 5.8 in size; takes two draws.

    Formula: ``sqrt(-2 ln(1 - u)) cos(2 pi v)``.

    Source: G. Box and M. Muller, "A Note on the Generation of Random Normal Deviates", 1958.
    """
    u = uniform(env, rng)  # not wp.randn: in which order that takes its two draws is up to the compiler
    v = uniform(env, rng)
    return wp.sqrt(-2.0 * wp.log(1.0 - u)) * wp.cos(2.0 * wp.pi * v)


@wp.func
def gaussian(env: int, rng: wp.array[wp.uint32], mean: float, std: float) -> float:
    """Normal with the given mean and standard deviation; takes two draws."""
    return mean + std * normal(env, rng)


@wp.func
def uniform_vec3(env: int, rng: wp.array[wp.uint32], bounds: wp.array[wp.vec2], first: int) -> wp.vec3:
    """Three numbers, uniform within ``bounds[first]`` and the two bounds after it."""
    x = uniform_range(env, rng, bounds[first])
    y = uniform_range(env, rng, bounds[first + 1])
    z = uniform_range(env, rng, bounds[first + 2])
    return wp.vec3(x, y, z)


@wp.func
def uniform_twist(env: int, rng: wp.array[wp.uint32], bounds: wp.array[wp.vec2]) -> wp.spatial_vector:
    """A linear and an angular part, uniform within six bounds: x, y, z, then about x, y, z."""
    linear = uniform_vec3(env, rng, bounds, 0)
    angular = uniform_vec3(env, rng, bounds, 3)
    return wp.spatial_vector(linear, angular)


@wp.func
def random_quat(env: int, rng: wp.array[wp.uint32]) -> wp.quat:
    """An orientation, uniform over all rotations; takes three draws.

    Formula: ``(sqrt(1 - u) sin a, sqrt(1 - u) cos a, sqrt(u) sin b, sqrt(u) cos b)``, ``a = 2 pi v``, ``b = 2 pi w``.

    Source: K. Shoemake, "Uniform Random Rotations", Graphics Gems III, 1992.
    """
    u = uniform(env, rng)
    a = 2.0 * wp.pi * uniform(env, rng)
    b = 2.0 * wp.pi * uniform(env, rng)
    r = wp.sqrt(1.0 - u)
    s = wp.sqrt(u)
    return wp.quat(r * wp.sin(a), r * wp.cos(a), s * wp.sin(b), s * wp.cos(b))
