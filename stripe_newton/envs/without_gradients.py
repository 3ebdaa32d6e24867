# SPDX-License-Identifier: Apache-2.0
"""Without gradients: a decorator for calls in which torch notes no gradients and makes ordinary tensors."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import torch

__all__ = ["without_gradients"]

P = ParamSpec("P")
T = TypeVar("T")


def without_gradients(function: Callable[P, T]) -> Callable[P, T]:
    """Call a function as under ``torch.inference_mode(False)`` and ``torch.no_grad()``, whatever the caller's modes.

    Tensors that are made in an inference mode could not be written outside of it. As a step calls several such
    functions, a mode is entered only where it is not there: each takes some microseconds of the host.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        if torch.is_inference_mode_enabled():
            with torch.inference_mode(False), torch.no_grad():
                return function(*args, **kwargs)
        if torch.is_grad_enabled():
            with torch.no_grad():
                return function(*args, **kwargs)
        return function(*args, **kwargs)

    return call
