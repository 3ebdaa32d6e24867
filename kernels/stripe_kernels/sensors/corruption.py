# SPDX-License-Identifier: Apache-2.0
"""Corruption of measurements: noise, bias and delay on ``(num_envs, size)`` floats of a sensor.

``begin_corruption`` takes the random numbers of a measurement from the environments' streams, then ``corrupt`` works
on all floats at once: the thread of a float computes the numbers that :mod:`stripe_kernels.mdp.random` would give it
if the floats drew one after another.
"""

import warp as wp

from ..processing import combine_noise, sample_gaussian, sample_uniform

__all__ = [
    "NOISE_CONSTANT",
    "NOISE_GAUSSIAN",
    "NOISE_NONE",
    "NOISE_UNIFORM",
    "Noise",
    "begin_corruption",
    "corrupt",
    "next_count",
    "restart_corruption",
    "uniform_at",
]

NOISE_NONE = wp.constant(0)
"""Kind of noise: none."""
NOISE_CONSTANT = wp.constant(1)
"""Kind of noise: a constant."""
NOISE_UNIFORM = wp.constant(2)
"""Kind of noise: uniform between two bounds."""
NOISE_GAUSSIAN = wp.constant(3)
"""Kind of noise: normal with a mean and a standard deviation."""


@wp.struct
class Noise:
    """Noise of each float of a measurement; shape ``(size,)`` each."""

    kind: wp.array[int]
    """Kind of noise: ``NOISE_NONE``, ``NOISE_CONSTANT``, ``NOISE_UNIFORM`` or ``NOISE_GAUSSIAN``."""
    operation: wp.array[int]
    """Operation, one of those of ``stripe_kernels.processing.combine_noise``."""
    a: wp.array[float]
    """The constant, the lower bound, or the mean."""
    b: wp.array[float]
    """The upper bound, or the standard deviation."""


@wp.func
def uniform_at(env: int, n: wp.uint32) -> float:
    """Uniform draw in [0, 1) at number ``n`` of a stream, the same as ``random.uniform``'s."""
    return wp.randf(wp.rand_init(env, wp.int32(n)))


@wp.func
def _sample_at(env: int, n: wp.uint32, kind: int, a: float, b: float) -> float:
    """Noise drawn at number ``n`` of a stream, the same as that of ``stripe_kernels.processing.sample_*``."""
    if kind == NOISE_UNIFORM:
        return a + (b - a) * uniform_at(env, n)
    if kind == NOISE_GAUSSIAN:
        v = uniform_at(env, n + wp.uint32(1))
        return a + b * (wp.sqrt(-2.0 * wp.log(1.0 - uniform_at(env, n))) * wp.cos(2.0 * wp.pi * v))
    return a


@wp.func
def next_count(count: int, depth: int) -> int:
    """The count of one more measurement, by whole rings of ``depth`` less once it exceeds two of them.

    The entry of the ring, ``count % depth``, is that of the full count, and a count above ``depth`` stays above it. The
    full count would overflow in an episode of 2^31 measurements.
    """
    more = count + 1
    if more >= 2 * depth + 2:
        return more - depth
    return more


@wp.kernel(enable_backward=False)
def begin_corruption(
    due: wp.array[wp.bool],
    draws: int,
    depth: int,
    rng: wp.array[wp.uint32],
    first: wp.array[wp.uint32],
    count: wp.array[int],
):
    """Reserve ``draws`` random numbers of each stream and count the measurement; one thread an environment.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        draws: Random numbers that a measurement takes.
        depth: Length of the ring of measurements that :func:`corrupt` gets.
        rng: Random streams, advanced, shape ``(num_envs,)``.
        first: Output, the first of the reserved numbers, shape ``(num_envs,)``.
        count: Measurements in the episode, counted up by :func:`next_count`, shape ``(num_envs,)``.
    """
    # A launch of its own: in ``corrupt`` the threads of an environment's floats would race for its stream.
    env = wp.tid()
    if due[env]:
        first[env] = rng[env]
        rng[env] = rng[env] + wp.uint32(draws)
        count[env] = next_count(count[env], depth)


@wp.kernel(enable_backward=False)
def corrupt(
    due: wp.array[wp.bool],
    noise: Noise,
    bias: wp.array2d[float],
    first: wp.array[wp.uint32],
    count: wp.array[int],
    raw: wp.array2d[float],
    ring: wp.array3d[float],
    out: wp.array2d[float],
):
    """Add noise and bias to a measurement, store it, and output the one ``delay`` before; threads (environment, float).

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        noise: Noise of the floats; each takes two random numbers, used or not.
        bias: Bias of the episode, shape ``(num_envs, size)``.
        first: First random number of the measurement, shape ``(num_envs,)``.
        count: Measurements in the episode, this one included, shape ``(num_envs,)``.
        raw: The measurement, shape ``(num_envs, size)``.
        ring: The last ``delay + 1`` noisy measurements, shape ``(num_envs, delay + 1, size)``.
        out: Output, the delayed measurement, shape ``(num_envs, size)``.
    """
    env, i = wp.tid()
    if not due[env]:
        return
    value = raw[env, i]
    if noise.kind[i] != NOISE_NONE:
        n = first[env] + wp.uint32(2 * i)
        value = combine_noise(value, _sample_at(env, n, noise.kind[i], noise.a[i], noise.b[i]), noise.operation[i])
    value += bias[env, i]
    depth = ring.shape[1]
    if count[env] == 1:  # the first measurement of an episode stands for those before it
        for k in range(depth):
            ring[env, k, i] = value
    ring[env, count[env] % depth, i] = value
    out[env, i] = ring[env, (count[env] + 1) % depth, i]  # the entry that the next measurement replaces is the oldest


@wp.kernel(enable_backward=False)
def restart_corruption(
    mask: wp.array[wp.bool],
    noise: Noise,
    shared: wp.array[wp.bool],
    rng: wp.array[wp.uint32],
    count: wp.array[int],
    bias: wp.array2d[float],
):
    """Start an episode: set the count of measurements to 0 and draw a new bias; one thread an environment.

    Args:
        mask: Environments that start an episode, shape ``(num_envs,)``.
        noise: Noise that the biases are drawn from, applied to zero; empty if no float has a bias.
        shared: Whether a float shares the bias of the float before it, shape ``(size,)``.
        rng: Random streams, advanced, shape ``(num_envs,)``.
        count: Measurements in the episode, shape ``(num_envs,)``.
        bias: Output, biases, shape ``(num_envs, size)``.
    """
    env = wp.tid()
    if not mask[env]:
        return
    count[env] = 0
    for i in range(noise.kind.shape[0]):
        if noise.kind[i] != NOISE_NONE:
            drawn = noise.a[i]
            if shared[i]:
                drawn = bias[env, i - 1]
            else:
                if noise.kind[i] == NOISE_UNIFORM:
                    drawn = sample_uniform(env, rng, noise.a[i], noise.b[i])
                if noise.kind[i] == NOISE_GAUSSIAN:
                    drawn = sample_gaussian(env, rng, noise.a[i], noise.b[i])
                drawn = combine_noise(0.0, drawn, noise.operation[i])
            bias[env, i] = drawn
