# SPDX-License-Identifier: Apache-2.0
"""Noise, bias and delay on what a sensor measures, ``(num_envs, size)`` floats.

``begin_corruption`` takes the random numbers of a measurement from the environments' streams, then ``corrupt`` works
on all floats at once: a thread draws what :mod:`stripe_kernels.mdp.random` would draw after all floats before its own.
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
    "restart_corruption",
]

NOISE_NONE = wp.constant(0)
NOISE_CONSTANT = wp.constant(1)
NOISE_UNIFORM = wp.constant(2)
NOISE_GAUSSIAN = wp.constant(3)


@wp.struct
class Noise:
    """What is drawn for each float, shape ``(size,)`` each."""

    kind: wp.array[int]
    """``NOISE_NONE``, ``NOISE_CONSTANT``, ``NOISE_UNIFORM`` or ``NOISE_GAUSSIAN``."""
    operation: wp.array[int]
    """How it enters, as ``stripe_kernels.processing.combine_noise`` has it."""
    a: wp.array[float]
    """The constant, the lower bound, or the mean."""
    b: wp.array[float]
    """The upper bound, or the standard deviation."""


@wp.func
def _uniform_at(env: int, n: wp.uint32) -> float:
    """What ``random.uniform`` draws at number ``n`` of the stream."""
    return wp.randf(wp.rand_init(env, wp.int32(n)))


@wp.func
def _sample_at(env: int, n: wp.uint32, kind: int, a: float, b: float) -> float:
    """What ``stripe_kernels.processing.sample_*`` draws at number ``n`` of the stream."""
    if kind == NOISE_UNIFORM:
        return a + (b - a) * _uniform_at(env, n)
    if kind == NOISE_GAUSSIAN:
        v = _uniform_at(env, n + wp.uint32(1))
        return a + b * (wp.sqrt(-2.0 * wp.log(1.0 - _uniform_at(env, n))) * wp.cos(2.0 * wp.pi * v))
    return a


@wp.kernel(enable_backward=False)
def begin_corruption(
    due: wp.array[wp.bool], draws: int, rng: wp.array[wp.uint32], first: wp.array[wp.uint32], count: wp.array[int]
):
    """Take ``draws`` random numbers of each stream and count the measurement.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        draws: Random numbers that a measurement takes.
        rng: Random streams, shape ``(num_envs,)``.
        first: The first of the numbers, shape ``(num_envs,)``.
        count: Measurements in the episode, shape ``(num_envs,)``.
    """
    env = wp.tid()
    if due[env]:
        first[env] = rng[env]
        rng[env] = rng[env] + wp.uint32(draws)
        count[env] = count[env] + 1


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
    """Put noise and bias on a measurement, and hand out an earlier one; threads (environment, float).

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        noise: What is drawn; each float takes two random numbers, used or not.
        bias: What is added in the whole episode, shape ``(num_envs, size)``.
        first: The first random number, shape ``(num_envs,)``.
        count: Measurements in the episode, shape ``(num_envs,)``.
        raw: The measurement, shape ``(num_envs, size)``.
        ring: The last ``delay + 1`` of them, filled with the first of an episode, shape
            ``(num_envs, delay + 1, size)``.
        out: What is read, shape ``(num_envs, size)``.
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
    if count[env] == 1:
        for k in range(depth):
            ring[env, k, i] = value
    ring[env, count[env] % depth, i] = value
    out[env, i] = ring[env, (count[env] + 1) % depth, i]


@wp.kernel(enable_backward=False)
def restart_corruption(
    mask: wp.array[wp.bool],
    noise: Noise,
    shared: wp.array[wp.bool],
    rng: wp.array[wp.uint32],
    count: wp.array[int],
    bias: wp.array2d[float],
):
    """Forget the measurements of an episode and draw a new bias, where ``mask`` says so.

    Args:
        mask: Environments, shape ``(num_envs,)``.
        noise: What the bias is drawn from, applied to zero; empty where no float has one.
        shared: Whether a float has the bias of the one before it, shape ``(size,)``.
        rng: Random streams, shape ``(num_envs,)``.
        count: Measurements in the episode, shape ``(num_envs,)``.
        bias: Biases, shape ``(num_envs, size)``.
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
