# SPDX-License-Identifier: Apache-2.0
"""What happens to a number between a term and the policy: noise, clip, modifiers, running statistics."""

import warp as wp

from .mdp import random

__all__ = [
    "NOISE_ABS",
    "NOISE_ADD",
    "NOISE_SCALE",
    "combine_noise",
    "merge_statistics",
    "normalize",
    "sample_constant",
    "sample_gaussian",
    "sample_uniform",
    "sum_moments",
]

NOISE_ADD = wp.constant(0)
NOISE_SCALE = wp.constant(1)
NOISE_ABS = wp.constant(2)


@wp.func
def sample_constant(env: int, rng: wp.array[wp.uint32], a: float, b: float) -> float:
    """``a``."""
    return a


@wp.func
def sample_uniform(env: int, rng: wp.array[wp.uint32], a: float, b: float) -> float:
    """Uniform in [``a``, ``b``)."""
    return a + (b - a) * random.uniform(env, rng)


@wp.func
def sample_gaussian(env: int, rng: wp.array[wp.uint32], a: float, b: float) -> float:
    """Normal with mean ``a`` and standard deviation ``b``."""
    return a + b * random.normal(env, rng)


@wp.func
def combine_noise(value: float, noise: float, operation: int) -> float:
    """``value + noise``, ``value * noise`` or ``noise``."""
    if operation == NOISE_ADD:
        return value + noise
    if operation == NOISE_SCALE:
        return value * noise
    return noise


@wp.func
def _origin(column: int, values: wp.array2d[float], seen: wp.array[float], mean: wp.array[float]) -> float:
    """What moments are taken about, lest a spread be lost beside a large mean: the mean so far, or the first value."""
    if seen[column] == 0.0:
        return values[0, column]
    return mean[column]


@wp.kernel(enable_backward=False)
def sum_moments(
    values: wp.array2d[float],
    count: int,
    seen: wp.array[float],
    mean: wp.array[float],
    sums: wp.array2d[float],
    squares: wp.array2d[float],
):
    """Sums and squares of what lies in a slice of the environments, about the present mean; threads (column, slice).

    Slices are fixed, so the result does not depend on the order of the threads.
    """
    column, part = wp.tid()
    origin = _origin(column, values, seen, mean)
    size = (count + sums.shape[1] - 1) // sums.shape[1]
    total = wp.float32(0.0)
    square = wp.float32(0.0)
    for k in range(part * size, wp.min(count, (part + 1) * size)):
        d = values[k, column] - origin
        total += d
        square += d * d
    sums[column, part] = total
    squares[column, part] = square


@wp.kernel(enable_backward=False)
def merge_statistics(
    values: wp.array2d[float],
    count: int,
    update: wp.array[int],
    index: int,
    sums: wp.array2d[float],
    squares: wp.array2d[float],
    seen: wp.array[float],
    mean: wp.array[float],
    var: wp.array[float],
):
    """Merge a batch into a running mean and variance; a thread a column, nothing where ``update[index]`` is 0.

    Source: T. Chan, G. Golub, R. LeVeque, "Algorithms for Computing the Sample Variance", 1983, pairwise update.
    """
    column = wp.tid()
    if update[index] == 0:
        return
    total = wp.float32(0.0)
    square = wp.float32(0.0)
    for part in range(sums.shape[1]):
        total += sums[column, part]
        square += squares[column, part]
    n = seen[column]
    m = float(count)
    offset = total / m
    batch = wp.max(square / m - offset * offset, 0.0)
    delta = _origin(column, values, seen, mean) + offset - mean[column]
    if n == 0.0:
        mean[column] = mean[column] + delta
        var[column] = batch
    else:
        mean[column] = mean[column] + delta * m / (n + m)
        var[column] = (n * var[column] + m * batch + delta * delta * n * m / (n + m)) / (n + m)
    seen[column] = n + m


@wp.kernel(enable_backward=False)
def normalize(
    values: wp.array2d[float],
    mean: wp.array[float],
    var: wp.array[float],
    eps: float,
    clip: float,
    normalized: wp.array2d[float],
):
    """``clamp((x - mean) / (sqrt(var) + eps), -clip, clip)``; threads (environment, column)."""
    env, column = wp.tid()
    x = (values[env, column] - mean[column]) / (wp.sqrt(var[column]) + eps)
    normalized[env, column] = wp.clamp(x, -clip, clip)
