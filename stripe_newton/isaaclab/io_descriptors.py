# SPDX-License-Identifier: Apache-2.0
"""Descriptors of terms' inputs and outputs: decorators that leave the term as it is.

Isaac Lab records what terms read and give for its exporter of environments; ``stripe-newton export`` reads that from
the environment itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, overload

__all__ = ["generic_io_descriptor", "record_nothing"]

F = TypeVar("F", bound=Callable[..., Any])


@overload
def generic_io_descriptor(func: F, **fields: object) -> F: ...


@overload
def generic_io_descriptor(func: None = None, **fields: object) -> Callable[[F], F]: ...


def generic_io_descriptor(func: F | None = None, **fields: object) -> F | Callable[[F], F]:
    """Decorator with or without arguments that returns the term unchanged."""
    return func if func is not None else lambda term: term


def record_nothing(output: object = None, descriptor: object = None, **kwargs: object) -> None:
    """A hook of the descriptors (``record_shape`` and others), which is never called."""
