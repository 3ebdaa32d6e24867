# SPDX-License-Identifier: Apache-2.0
"""Processing of observations between a term and the policy: noise and running normalisation."""

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
"""Operation of noise: it is added to the value."""
NOISE_SCALE = wp.constant(1)
"""Operation of noise: the value is multiplied by it."""
NOISE_ABS = wp.constant(2)
"""Operation of noise: it replaces the value."""


@wp.func
def sample_constant(env: int, rng: wp.array[wp.uint32], a: float, b: float) -> float:
    """Constant ``a``; takes no draw."""
    return a


@wp.func
def sample_uniform(env: int, rng: wp.array[wp.uint32], a: float, b: float) -> float:
    """Sample uniform in [``a``, ``b``); takes one draw."""
    return a + (b - a) * random.uniform(env, rng)


@wp.func
def sample_gaussian(env: int, rng: wp.array[wp.uint32], a: float, b: float) -> float:
    """Normal sample with mean ``a`` and standard deviation ``b``; takes two draws."""
    return a + b * random.normal(env, rng)


@wp.func
def combine_noise(value: float, noise: float, operation: int) -> float:
    """Value with noise: ``value + noise``, ``value * noise`` or ``noise``, by the ``NOISE`` constants."""
    if operation == NOISE_ADD:
        return value + noise
    if operation == NOISE_SCALE:
        return value * noise
    return noise


@wp.func
def _moment_origin(column: int, values: wp.array2d[float], seen: wp.array[float], mean: wp.array[float]) -> float:
    """Origin that moments are taken about: the mean so far, or the first value of the first batch."""
    # About 0, the squares of a large mean would leave no digits of float32 for a small variance.
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
    """Sum deviations from the present mean and their squares over slices of the environments; threads (column, slice).

    Args:
        values: Observations, shape ``(num_envs, columns)``.
        count: Number of environments.
        seen: Environments merged into the statistics so far, shape ``(columns,)``.
        mean: Running means, shape ``(columns,)``.
        sums: Output, sums of deviations, shape ``(columns, slices)``.
        squares: Output, sums of their squares, shape ``(columns, slices)``.
    """
    # The slices are fixed and each has one thread, without atomics: the sums do not depend on the threads' order, and
    # two runs give the same statistics to the last bit.
    column, part = wp.tid()
    origin = _moment_origin(column, values, seen, mean)
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
    """Merge a batch into a running mean and variance; one thread a column.

    Args:
        values: Observations of the batch, shape ``(num_envs, columns)``.
        count: Number of environments.
        update: Flags of the environment; nothing is merged while ``update[index]`` is 0.
        index: Index of this group's flag.
        sums: Sums of deviations by :func:`sum_moments`, shape ``(columns, slices)``.
        squares: Sums of their squares, shape ``(columns, slices)``.
        seen: Environments merged so far, updated, shape ``(columns,)``.
        mean: Running means, updated, shape ``(columns,)``.
        var: Running variances, updated, shape ``(columns,)``.

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
    batch = wp.max(square / m - offset * offset, 0.0)  # rounding may make the difference negative
    # From the running mean to the batch's. The origin must be that of sum_moments: ``seen`` and ``mean`` change below.
    delta = _moment_origin(column, values, seen, mean) + offset - mean[column]
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
    """Normalise observations: ``clamp((x - mean) / (sqrt(var) + eps), -clip, clip)``; threads (environment, column)."""
    env, column = wp.tid()
    x = (values[env, column] - mean[column]) / (wp.sqrt(var[column]) + eps)
    normalized[env, column] = wp.clamp(x, -clip, clip)
