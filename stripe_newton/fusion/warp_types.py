# SPDX-License-Identifier: Apache-2.0
"""Warp types: type aliases for structs and their instances, which Warp does not export, and functions on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias, TypeGuard, TypeVar

import warp as wp

__all__ = [
    "SCALARS",
    "Struct",
    "StructInstance",
    "Value",
    "dtype_of",
    "is_instance",
    "name_of",
    "struct_fields",
    "struct_of",
]

Struct: TypeAlias = type
"""A Warp struct, which is written as a class."""
StructInstance: TypeAlias = object
"""An instance of a Warp struct; its fields are attributes."""
Value: TypeAlias = object
"""A Warp array or an instance of a struct, as an argument of a kernel."""

SCALARS = {float: float, wp.float32: float, int: int, wp.int32: int, bool: bool, wp.bool: bool}
"""Types of numbers as Python's, by the types with which a Warp function may be annotated."""


def struct_fields(kind: Struct) -> Mapping[str, object]:
    """The fields of a struct by name."""
    fields: Mapping[str, object] = kind.vars  # type: ignore[attr-defined]
    return fields


def dtype_of(kind: Struct, field: str) -> type:
    """Type of the elements of a field that is an array."""
    dtype: type = kind.vars[field].type.dtype  # type: ignore[attr-defined]
    return dtype


def name_of(kind: Struct) -> str:
    """The name of a struct's class."""
    key: str = kind.key  # type: ignore[attr-defined]
    return key.rpartition(".")[2]


def struct_of(instance: StructInstance) -> Struct:
    """The struct of an instance."""
    kind: Struct = instance._cls  # type: ignore[attr-defined]
    return kind


T = TypeVar("T")


def is_instance(value: object, kind: type[T]) -> TypeGuard[T]:
    """Whether a value is an instance of a struct."""
    return bool(wp.types.is_struct(value)) and struct_of(value) is kind
