# SPDX-License-Identifier: Apache-2.0
"""Distributions and operations of randomising events.

A randomising event computes a quantity of the model from its default, the value that the model was built with. The
modules ``randomization_*`` hold the terms by the quantities that they change; the decorator ``@randomizes`` declares
their parameters.
"""

import math
import warnings
from typing import TYPE_CHECKING

import warp as wp

from .. import term_info
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

if not TYPE_CHECKING:  # a type checker takes every name of a module that has a __getattr__ for defined

    def __getattr__(name: str) -> object:
        """Forward ``Randomization``, with a warning, to where it has moved."""
        if name != "Randomization":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        new = "stripe_kernels.term_info.Randomization"
        warnings.warn(
            f"{__name__}.Randomization has moved to {new}; the old name goes with the next release",
            DeprecationWarning,
            stacklevel=2,
        )
        return term_info.Randomization


OPERATIONS: dict[str, int] = {"add": 0, "scale": 1, "abs": 2}
"""Operations that combine a default with a draw, by Isaac Lab's names, with the codes that terms receive."""

DISTRIBUTIONS: dict[str, int] = {"uniform": 0, "log_uniform": 1, "gaussian": 2}
"""Distributions by Isaac Lab's names, with the codes that terms receive."""

KEEP = (math.nan, math.nan)
"""Range of a quantity that a term must not change."""

ADD = wp.constant(OPERATIONS["add"])
SCALE = wp.constant(OPERATIONS["scale"])
LOG_UNIFORM = wp.constant(DISTRIBUTIONS["log_uniform"])
GAUSSIAN = wp.constant(DISTRIBUTIONS["gaussian"])


@wp.func
def sample(env: int, rng: wp.array[wp.uint32], params: wp.vec2, distribution: int) -> float:
    """Draw from a distribution with two parameters.

    Formula: ``U(a, b)``; log-uniform ``exp(U(ln a, ln b))``; Gaussian with mean ``a`` and standard deviation ``b``.
    """
    if distribution == GAUSSIAN:
        return random.gaussian(env, rng, params[0], params[1])
    if distribution == LOG_UNIFORM:
        return wp.exp(random.uniform_range(env, rng, wp.vec2(wp.log(params[0]), wp.log(params[1]))))
    return random.uniform_range(env, rng, params)


@wp.func
def operate(default: float, draw: float, operation: int) -> float:
    """Combine a default with a draw: ``default + draw``, ``default * draw`` or ``draw``; codes as of ``OPERATIONS``."""
    if operation == ADD:
        return default + draw
    if operation == SCALE:
        return default * draw
    return draw


@wp.func
def randomize(
    env: int, rng: wp.array[wp.uint32], default: float, params: wp.vec2, operation: int, distribution: int
) -> float:
    """Draw a new value of a quantity from its default."""
    return operate(default, sample(env, rng, params, distribution), operation)


@wp.func
def is_kept(params: wp.vec2) -> bool:
    """Whether a range is ``KEEP``: its bounds are NaN."""
    return wp.isnan(params[0])
