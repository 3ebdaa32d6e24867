# SPDX-License-Identifier: Apache-2.0
"""Distributions and operations of randomising events.

A term changes a quantity of the model where it runs, always from the value that the model was built with. The
``randomization_*`` modules hold the terms by what they change; ``@randomizes`` says what their configs may say.
"""

import math

import warp as wp

from . import random

__all__ = [
    "DISTRIBUTIONS",
    "KEEP",
    "OPERATIONS",
    "is_kept",
    "operate",
    "randomize",
    "sample",
]

OPERATIONS: dict[str, int] = {"add": 0, "scale": 1, "abs": 2}
"""What becomes of a draw, by Isaac Lab's names, and the number that a term is given."""

DISTRIBUTIONS: dict[str, int] = {"uniform": 0, "log_uniform": 1, "gaussian": 2}
"""What is drawn from, by Isaac Lab's names, and the number that a term is given."""

KEEP = (math.nan, math.nan)
"""In the place of a range: the quantity stays as it is."""

ADD = wp.constant(OPERATIONS["add"])
SCALE = wp.constant(OPERATIONS["scale"])
LOG_UNIFORM = wp.constant(DISTRIBUTIONS["log_uniform"])
GAUSSIAN = wp.constant(DISTRIBUTIONS["gaussian"])


@wp.func
def sample(env: int, rng: wp.array[wp.uint32], params: wp.vec2, distribution: int) -> float:
    """A draw from a distribution with two parameters.

    Formula: ``U(a, b)``; log-uniform ``exp(U(ln a, ln b))``; Gaussian with mean ``a`` and standard deviation ``b``.
    """
    if distribution == GAUSSIAN:
        return random.gaussian(env, rng, params[0], params[1])
    if distribution == LOG_UNIFORM:
        return wp.exp(random.uniform_range(env, rng, wp.vec2(wp.log(params[0]), wp.log(params[1]))))
    return random.uniform_range(env, rng, params)


@wp.func
def operate(default: float, draw: float, operation: int) -> float:
    """``default + draw``, ``default * draw`` or ``draw``, as ``OPERATIONS`` numbers them."""
    if operation == ADD:
        return default + draw
    if operation == SCALE:
        return default * draw
    return draw


@wp.func
def randomize(
    env: int, rng: wp.array[wp.uint32], default: float, params: wp.vec2, operation: int, distribution: int
) -> float:
    """A new value for a quantity whose default is ``default``."""
    return operate(default, sample(env, rng, params, distribution), operation)


@wp.func
def is_kept(params: wp.vec2) -> bool:
    """Whether a range is ``KEEP``."""
    return wp.isnan(params[0])
