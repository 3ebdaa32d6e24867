# SPDX-License-Identifier: Apache-2.0
"""Warp structs: reading and copying the fields of an instance."""

from __future__ import annotations

from typing import Any, TypeVar

__all__ = ["copy_struct", "field_values"]

T = TypeVar("T")


def field_values(struct: Any) -> dict[str, Any]:
    """Values of the fields of an instance of a ``@wp.struct``, by name."""
    return {name: getattr(struct, name) for name in struct._cls.vars}


def copy_struct(struct: T, like: type[T]) -> T:
    """Another instance with the same arrays and numbers.

    Args:
        struct: The instance.
        like: Its ``@wp.struct``; the instance's own type is one of Warp's.
    """
    made = like()
    for name, value in field_values(struct).items():
        setattr(made, name, value)
    return made
