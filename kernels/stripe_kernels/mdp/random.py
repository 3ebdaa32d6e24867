# SPDX-License-Identifier: Apache-2.0
"""Random draws from one stream for each environment.

``rng`` holds one number an environment, shape ``(num_envs,)``, which every draw advances in place. The stream of an
environment depends on the seed and on its index, not on the number of environments, nor on how draws are split over
launches.

A draw hashes the number together with the index. Among thousands of streams over 2^32 numbers, two environments do
reach the same number at times. Without the index in the hash they would draw the same values from then on.
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
    """First number of the stream of environment ``env`` for a ``seed``."""
    return wp.rand_init(seed, env)


@wp.func
def draw(env: int, rng: wp.array[wp.uint32]) -> wp.uint32:
    """Draw 32 random bits.

    Formula: ``h(env + h(n)); n <- n + 1``, ``h`` the hash PCG-RXS-M-XS.

    Source: M. Jarzynski and M. Olano, "Hash Functions for GPU Rendering", J. Computer Graphics Techniques 9(3), 2020.
    """
    n = rng[env]
    rng[env] = n + wp.uint32(1)
    return wp.rand_init(env, wp.int32(n))


@wp.func
def uniform(env: int, rng: wp.array[wp.uint32]) -> float:
    """Uniform draw in [0, 1), a multiple of 2^-24."""
    return wp.randf(draw(env, rng))


@wp.func
def uniform_range(env: int, rng: wp.array[wp.uint32], bounds: wp.vec2) -> float:
    """Uniform draw between ``bounds[0]`` and ``bounds[1]``; takes one draw even if they are equal."""
    # So that a config with an empty range leaves all other draws of its environment as they are.
    u = uniform(env, rng)
    return bounds[0] + (bounds[1] - bounds[0]) * u


@wp.func
def bernoulli(env: int, rng: wp.array[wp.uint32], probability: float) -> bool:
    """Bernoulli draw: True with a probability; never at 0, always at 1."""
    return uniform(env, rng) < probability


@wp.func
def normal(env: int, rng: wp.array[wp.uint32]) -> float:
    """Normal draw with mean 0 and standard deviation 1, at most 5.8 in size; takes two draws.

    Formula: ``sqrt(-2 ln(1 - u)) cos(2 pi v)``.

    Source: G. Box and M. Muller, "A Note on the Generation of Random Normal Deviates", 1958.
    """
    # Not wp.randn: there the compiler chooses the order of the two draws.
    u = uniform(env, rng)
    v = uniform(env, rng)
    # 1 - u is never 0, for u < 1; its least value, 2^-24, gives the bound of 5.8.
    return wp.sqrt(-2.0 * wp.log(1.0 - u)) * wp.cos(2.0 * wp.pi * v)


@wp.func
def gaussian(env: int, rng: wp.array[wp.uint32], mean: float, std: float) -> float:
    """Normal draw with a mean and a standard deviation; takes two draws."""
    return mean + std * normal(env, rng)


@wp.func
def uniform_vec3(env: int, rng: wp.array[wp.uint32], bounds: wp.array[wp.vec2], first: int) -> wp.vec3:
    """Vector of three uniform draws, within ``bounds[first]`` and the two bounds after it."""
    x = uniform_range(env, rng, bounds[first])
    y = uniform_range(env, rng, bounds[first + 1])
    z = uniform_range(env, rng, bounds[first + 2])
    return wp.vec3(x, y, z)


@wp.func
def uniform_twist(env: int, rng: wp.array[wp.uint32], bounds: wp.array[wp.vec2]) -> wp.spatial_vector:
    """Twist of six uniform draws, within six bounds: linear x, y, z, then angular about x, y, z."""
    linear = uniform_vec3(env, rng, bounds, 0)
    angular = uniform_vec3(env, rng, bounds, 3)
    return wp.spatial_vector(linear, angular)


@wp.func
def random_quat(env: int, rng: wp.array[wp.uint32]) -> wp.quat:
    """Random orientation, uniform over all rotations; takes three draws.

    Formula: ``(sqrt(1 - u) sin a, sqrt(1 - u) cos a, sqrt(u) sin b, sqrt(u) cos b)``, ``a = 2 pi v``, ``b = 2 pi w``.

    Source: K. Shoemake, "Uniform Random Rotations", Graphics Gems III, 1992.
    """
    u = uniform(env, rng)
    a = 2.0 * wp.pi * uniform(env, rng)
    b = 2.0 * wp.pi * uniform(env, rng)
    r = wp.sqrt(1.0 - u)
    s = wp.sqrt(u)
    return wp.quat(r * wp.sin(a), r * wp.cos(a), s * wp.sin(b), s * wp.cos(b))
