# SPDX-License-Identifier: Apache-2.0
"""Config classes of a user's files under the Isaac Lab dialect: an instance may be given fields that its class lacks.

Isaac Lab's tasks add assets, terms and values of their own to a config in ``__post_init__``.
"""

from __future__ import annotations

import functools
from typing import TypeVar

from stripe_newton import configclass as native

__all__ = ["configclass"]

T = TypeVar("T")


def configclass(cls: type[T]) -> type[T]:
    """:func:`stripe_newton.configclass.configclass`, whose instances take new fields."""
    made = native.configclass(cls)
    made.adopt_field = _adopt_field  # type: ignore[attr-defined]  # read by the config class when a field is unknown
    return made


def _adopt_field(self: object, name: str, value: object) -> None:
    """Give an instance one more field: its class becomes one that has it."""
    object.__setattr__(self, "__class__", _with_field(type(self), name))
    object.__setattr__(self, name, value)


@functools.cache
def _with_field(cls: type, name: str) -> type:
    """The class with one more field, always the same for equal arguments."""
    body = {
        "__doc__": cls.__doc__,
        "__module__": cls.__module__,
        "__qualname__": cls.__qualname__,
        "__annotations__": {name: object},
        name: None,
    }
    return configclass(type(cls.__name__, (cls,), body))
