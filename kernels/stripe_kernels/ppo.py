# SPDX-License-Identifier: Apache-2.0
"""PPO kernels: loss of a minibatch with its gradient, and the gradient of an ELU with that of the bias before it."""

from typing import Any

import warp as wp

__all__ = [
    "BLOCK",
    "LOSS_TERMS",
    "elu_gradient",
    "elu_gradient_bf16",
    "finish_ppo_loss",
    "gather_inputs",
    "ppo_loss",
]

BLOCK = 64
"""Threads of a block for all kernels here: few, so that samples of a minibatch are spread over all multiprocessors."""

LOSS_TERMS = 3
"""Rows of ``terms`` of :func:`ppo_loss` before those by standard deviations: surrogate, value loss, KL divergence."""

_HALF_LOG_2PI = wp.constant(0.9189385332046727)


@wp.kernel(enable_backward=False)
def gather_inputs(
    indices: wp.array[wp.int64],
    rows: wp.array2d[float],
    first: int,
    mean: wp.array2d[float],
    std: wp.array2d[float],
    eps: float,
    out: wp.array2d[Any],
):
    """Gather observations of samples, normalised; launch ``(m, w)`` threads.

    Args:
        indices: Row of each sample, ``(m,)``.
        rows: A group of observations, ``(n, w)``.
        first: Column of ``out`` that the group begins at.
        mean: Running means, ``(1, columns)``, or nothing for no normalisation.
        std: Running standard deviations, ``(1, columns)``.
        eps: Added to the deviations.
        out: Inputs of a network, float32 or bfloat16, ``(m, columns)``.
    """
    i, j = wp.tid()
    value = rows[int(indices[i]), j]
    if mean:
        value = (value - mean[0, first + j]) / (std[0, first + j] + eps)
    out[i, first + j] = out.dtype(value)


for _number in (wp.float32, wp.bfloat16):  # known before the module is compiled, so that it is compiled once
    wp.overload(gather_inputs, {"out": wp.array2d[_number]})


@wp.func
def _deviation(parameter: float, low: float, high: float, is_log: bool) -> float:
    """Standard deviation of an action, by its parameter, or by the logarithm of it that the parameter is."""
    bounded = wp.clamp(parameter, low, high)
    return wp.where(is_log, wp.exp(bounded), bounded)


@wp.kernel(enable_backward=False)
def ppo_loss(
    indices: wp.array[wp.int64],
    mean: wp.array2d[float],
    std_parameter: wp.array[float],
    low: float,
    high: float,
    is_log: bool,
    value: wp.array[float],
    actions: wp.array2d[float],
    old_mean: wp.array2d[float],
    old_std: wp.array2d[float],
    old_log_prob: wp.array[float],
    old_value: wp.array[float],
    advantages: wp.array[float],
    returns: wp.array[float],
    advantage_scale: wp.array[float],
    clip: float,
    value_weight: float,
    clips_value: bool,
    mean_gradient: wp.array2d[float],
    value_gradient: wp.array[float],
    terms: wp.array2d[float],
):
    """Loss terms of each sample, and the gradient of their mean; launch one thread for each of ``m`` samples.

    The loss is the clipped surrogate (Schulman et al., arXiv:1707.06347, equation 7, its sign changed) plus
    ``value_weight`` times the value loss. The entropy does not depend on the sample and is left to the caller.

    Args:
        indices: Row of each sample in the storage, ``(m,)``.
        mean: Means of the actions, ``(m, k)``.
        std_parameter: Parameters of the standard deviations of the actions, ``(k,)``.
        low: Lower bound of those parameters.
        high: Upper bound of the same.
        is_log: Whether they are logarithms of the deviations.
        value: Values, ``(m,)``.
        actions: Actions in the storage, ``(n, k)``.
        old_mean: Means of the distributions that they were drawn from, ``(n, k)``.
        old_std: Standard deviations of the same, ``(n, k)``.
        old_log_prob: Logarithms of the actions' densities then, ``(n,)``.
        old_value: Values then, ``(n,)``.
        advantages: Advantages, ``(n,)``.
        returns: Returns, ``(n,)``.
        advantage_scale: What is subtracted from an advantage, and what it is then divided by, ``(2,)``.
        clip: Largest distance of the probability ratio from 1, and of a value from the old one.
        value_weight: Weight of the value loss.
        clips_value: Whether the value loss is clipped.
        mean_gradient: Gradient by ``mean``, ``(m, k)``.
        value_gradient: Gradient by ``value``, ``(m,)``.
        terms: Surrogate, value loss, KL divergence, then the surrogate's derivatives by the standard deviations; their
            means over the samples are those of the minibatch, ``(3 + k, m)``.
    """
    i = wp.tid()
    row = int(indices[i])
    count = mean.shape[1]
    scale = 1.0 / float(mean.shape[0])

    log_prob, kl = wp.float32(0.0), wp.float32(0.0)
    for j in range(count):
        s = _deviation(std_parameter[j], low, high, is_log)
        z = (actions[row, j] - mean[i, j]) / s
        log_prob += -0.5 * z * z - wp.log(s) - _HALF_LOG_2PI
        # KL of the old distribution from the new one: half of variance ratio + squared distance - 1 - log ratio
        ratio_s = old_std[row, j] / s
        shift = (old_mean[row, j] - mean[i, j]) / s
        kl += 0.5 * (ratio_s * ratio_s + shift * shift - 1.0 - 2.0 * wp.log(ratio_s))

    advantage = (advantages[row] - advantage_scale[0]) / advantage_scale[1]
    ratio = wp.exp(log_prob - old_log_prob[row])
    unclipped = -advantage * ratio
    clipped = -advantage * wp.clamp(ratio, 1.0 - clip, 1.0 + clip)
    # Where the clipped one is larger, the surrogate does not depend on the policy.
    grad_log_prob = wp.where(unclipped >= clipped, unclipped, 0.0)
    terms[0, i] = wp.max(unclipped, clipped)
    terms[2, i] = kl
    for j in range(count):
        s = _deviation(std_parameter[j], low, high, is_log)
        z = (actions[row, j] - mean[i, j]) / s
        mean_gradient[i, j] = scale * grad_log_prob * z / s
        terms[3 + j, i] = grad_log_prob * (z * z - 1.0) / s

    error = value[i] - returns[row]
    loss, grad_value = error * error, 2.0 * error
    if clips_value:
        change = value[i] - old_value[row]
        error = old_value[row] + wp.clamp(change, -clip, clip) - returns[row]
        if error * error > loss:
            loss = error * error
            grad_value = wp.where(wp.abs(change) <= clip, 2.0 * error, 0.0)
    terms[1, i] = loss
    value_gradient[i] = scale * value_weight * grad_value


@wp.kernel(enable_backward=False)
def finish_ppo_loss(
    means: wp.array[float],
    std_parameter: wp.array[float],
    low: float,
    high: float,
    is_log: bool,
    entropy_weight: float,
    losses: wp.array[float],
    kl: wp.array[float],
    mean_std: wp.array[float],
    std_gradient: wp.array[float],
):
    """Sum losses and add the entropy's part to the gradient by the standard deviations; launch one thread.

    Args:
        means: Means of the ``terms`` of :func:`ppo_loss`, ``(3 + k,)``.
        std_parameter: As in :func:`ppo_loss`, ``(k,)``.
        low: As in :func:`ppo_loss`.
        high: As in :func:`ppo_loss`.
        is_log: As in :func:`ppo_loss`.
        entropy_weight: Weight of the entropy, which is subtracted from the loss.
        losses: Value loss, surrogate and entropy are added, ``(3 or more,)``.
        kl: KL divergence, ``(1,)``.
        mean_std: Mean of the standard deviations, ``(1,)``.
        std_gradient: Gradient by ``std_parameter``, ``(k,)``, or nothing where they are not trained.
    """
    count = std_parameter.shape[0]
    entropy, total = wp.float32(0.0), wp.float32(0.0)
    for j in range(count):
        s = _deviation(std_parameter[j], low, high, is_log)
        total += s
        entropy += 0.5 + _HALF_LOG_2PI + wp.log(s)
        if std_gradient:
            gradient = means[3 + j] - entropy_weight / s
            if is_log:
                gradient *= s
            inside = low <= std_parameter[j] and std_parameter[j] <= high
            std_gradient[j] = wp.where(inside, gradient, 0.0)
    losses[0] = losses[0] + means[1]
    losses[1] = losses[1] + means[0]
    losses[2] = losses[2] + entropy
    kl[0] = means[2]
    mean_std[0] = total / float(count)


@wp.func
def _elu_slope(activation: float) -> float:
    """Derivative of the exponential linear unit, by its result."""
    return wp.where(activation > 0.0, 1.0, activation + 1.0)


@wp.kernel(enable_backward=False)
def elu_gradient(
    gradient: wp.array2d[float], activation: wp.array2d[float], rows: int, bias_gradient: wp.array2d[float]
):
    """Gradient behind an ELU to that before it, in place, and its sums over blocks of samples.

    Launch ``(ceil(m / rows), k)`` threads for gradients ``(m, k)``.

    Args:
        gradient: By the results; becomes that by the arguments, ``(m, k)``.
        activation: Results of the ELU, ``(m, k)``.
        rows: Samples in a block.
        bias_gradient: Sums over the samples of each block, ``(blocks, k)``; they add up to the gradient of the bias.
    """
    block, column = wp.tid()
    total = wp.float32(0.0)
    for row in range(block * rows, wp.min((block + 1) * rows, gradient.shape[0])):
        value = gradient[row, column] * _elu_slope(activation[row, column])
        gradient[row, column] = value
        total += value
    bias_gradient[block, column] = total


@wp.func
def _low(pair: wp.uint32) -> float:
    return wp.cast(pair << wp.uint32(16), float)


@wp.func
def _high(pair: wp.uint32) -> float:
    return wp.cast((pair >> wp.uint32(16)) << wp.uint32(16), float)


@wp.func
def _rounded(value: float) -> wp.uint32:
    """The bits of ``value`` as bfloat16, rounded to the nearest, in the upper half of a word."""
    bits = wp.cast(value, wp.uint32)
    bits += wp.uint32(0x7FFF) + ((bits >> wp.uint32(16)) & wp.uint32(1))
    return (bits >> wp.uint32(16)) << wp.uint32(16)


@wp.kernel(enable_backward=False)
def elu_gradient_bf16(
    gradient: wp.array2d[wp.uint32], activation: wp.array2d[wp.uint32], rows: int, bias_gradient: wp.array2d[float]
):
    """:func:`elu_gradient` for pairs of bfloat16 numbers, each a word: ``(m, k / 2)`` words, ``(blocks, k)`` sums.

    Launch ``(ceil(m / rows), k / 2)`` threads.
    """
    block, column = wp.tid()
    first, second = wp.float32(0.0), wp.float32(0.0)
    for row in range(block * rows, wp.min((block + 1) * rows, gradient.shape[0])):
        before, result = gradient[row, column], activation[row, column]
        low = _rounded(_low(before) * _elu_slope(_low(result)))
        high = _rounded(_high(before) * _elu_slope(_high(result)))
        gradient[row, column] = high | (low >> wp.uint32(16))
        # The sums are over the rounded numbers, which the weights' gradients are made of.
        first += wp.cast(low, float)
        second += wp.cast(high, float)
    bias_gradient[block, 2 * column] = first
    bias_gradient[block, 2 * column + 1] = second
