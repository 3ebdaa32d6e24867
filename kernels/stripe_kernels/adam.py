# SPDX-License-Identifier: Apache-2.0
"""Adam kernels: the adaptive learning rate, and a step with clipped gradients on parameters in one piece of memory."""

import warp as wp

__all__ = ["adapt_rate", "prepare_adam", "take_adam_step"]


@wp.kernel(enable_backward=False)
def adapt_rate(
    kl: wp.array[float], desired: float, smallest: wp.float64, largest: wp.float64, rate: wp.array[wp.float64]
):
    """Adapt a learning rate to the KL divergence of an update, by rsl_rl's rule; launch one thread.

    Args:
        kl: KL divergence of the old policy from the new one, ``(1,)``.
        desired: KL divergence that is aimed at.
        smallest: Lower bound of the rate.
        largest: Upper bound of the rate.
        rate: Learning rate, changed, ``(1,)``.
    """
    if kl[0] > 2.0 * desired:
        rate[0] = wp.max(smallest, rate[0] / wp.float64(1.5))
    elif kl[0] < 0.5 * desired and kl[0] > 0.0:
        rate[0] = wp.min(largest, rate[0] * wp.float64(1.5))


@wp.kernel(enable_backward=False)
def prepare_adam(
    rate: wp.array[wp.float64], beta1: wp.float64, beta2: wp.float64, step: wp.array[float], factors: wp.array[float]
):
    """Count a step, and compute what is the same for all parameters; launch one thread.

    Args:
        rate: Learning rate, ``(1,)``.
        beta1: Decay of the mean of gradients.
        beta2: Decay of the mean of their squares.
        step: Number of steps, changed, ``(1,)``.
        factors: Rate over the first bias correction, root of the second one, and rate, ``(3,)``.
    """
    step[0] = step[0] + 1.0
    count = wp.float64(step[0])
    factors[0] = float(rate[0] / (wp.float64(1.0) - wp.pow(beta1, count)))
    factors[1] = float(wp.sqrt(wp.float64(1.0) - wp.pow(beta2, count)))
    factors[2] = float(rate[0])


@wp.kernel(enable_backward=False)
def take_adam_step(
    gradient: wp.array[float],
    norms: wp.array[float],
    first_of_second: int,
    max_norm: float,
    factors: wp.array[float],
    beta1: float,
    rest1: float,
    beta2: float,
    rest2: float,
    eps: float,
    decay: float,
    decouples: bool,
    mean: wp.array[float],
    mean_square: wp.array[float],
    parameter: wp.array[float],
):
    """A step of Adam or AdamW, whose gradients are clipped for each of two networks; one thread for each parameter.

    Reference:
        Kingma and Ba, arXiv:1412.6980; Loshchilov and Hutter, arXiv:1711.05101.

    Args:
        gradient: Gradient, ``(n,)``.
        norms: Norms of the gradients of the two networks, ``(2,)``.
        first_of_second: First parameter of the second network.
        max_norm: Largest norm of the gradient of a network.
        factors: Those of :func:`prepare_adam`, ``(3,)``.
        beta1: Decay of ``mean``.
        rest1: 1 - ``beta1``, which a difference of numbers of 32 bits would miss by 1e-5 of its value.
        beta2: Decay of ``mean_square``.
        rest2: 1 - ``beta2``.
        eps: Added to the root of the mean square.
        decay: Weight decay.
        decouples: Whether the decay shrinks parameters (AdamW) rather than being a part of the gradient (Adam).
        mean: Running mean of gradients, changed, ``(n,)``.
        mean_square: Running mean of their squares, changed, ``(n,)``.
        parameter: Parameters, changed, ``(n,)``.
    """
    i = wp.tid()
    norm = norms[wp.where(i < first_of_second, 0, 1)]
    g = gradient[i] * wp.min(max_norm / (norm + 1.0e-6), 1.0)
    value = parameter[i]
    if decouples:
        value -= factors[2] * decay * value
    else:
        g += decay * value
    m = beta1 * mean[i] + rest1 * g
    v = beta2 * mean_square[i] + rest2 * g * g
    mean[i] = m
    mean_square[i] = v
    parameter[i] = value - factors[0] * m / (wp.sqrt(v) / factors[1] + eps)
