# SPDX-License-Identifier: Apache-2.0
"""Array layout: strides and lengths of a kernel's arrays, written into its source code as numbers.

Warp passes them with each array. The compiler then multiplies 64-bit numbers for each element, and does not know how
long loops over joints are. With numbers it adds a constant to the address of a row, which halves the code.

>>> import warp as wp
>>> from stripe_newton.fusion.array_layout import layout_lines
>>> joint_pos = wp.zeros((64, 12), dtype=float, device="cpu")
>>> joint_ids = wp.zeros(12, dtype=int, device="cpu")
>>> for line in layout_lines({"joint_pos": joint_pos, "joint_ids": joint_ids}, num_envs=64):
...     print(line)
joint_pos.strides[0] = 48;
joint_pos.strides[1] = 4;
joint_pos.shape.dims[1] = 12;
joint_ids.strides[0] = 4;
joint_ids.shape.dims[0] = 12;
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import warp as wp

from .usage import Usage
from .warp_types import Value, struct_fields, struct_of

__all__ = ["arrays_of", "layout_lines"]

_MAX_LENGTH = 128
"""Longest first dimension that becomes a number: that of a table, such as indices of joints."""


def arrays_of(
    arguments: Mapping[str, Value], uses: frozenset[str], called: Sequence[Usage] = ()
) -> dict[str, wp.array]:
    """The arrays of a kernel that have memory, by the expressions that name them.

    Args:
        arguments: Arrays and structs of the kernel by name.
        uses: Names in its sections, which hold ``struct.field`` for fields that they use themselves.
        called: Usages of the functions that the sections call.
    """
    named = ((e, a) for name, value in arguments.items() for e, a in _arrays(name, value, uses, called))
    return {expression: array for expression, array in named if isinstance(array, wp.array) and array.ptr}


def layout_lines(arrays: Mapping[str, wp.array], num_envs: int) -> list[str]:
    """Lines of C++ that set strides [bytes] and lengths of arrays.

    The number of environments is left to the launch, so that a kernel is compiled once for any.

    Args:
        arrays: Arrays by the expressions that name them.
        num_envs: Number of environments.
    """
    lines = []
    for expression, array in arrays.items():
        lines += [f"{expression}.strides[{k}] = {stride};" for k, stride in enumerate(array.strides)]
        lengths = list(enumerate(array.shape))
        is_table = array.shape[0] != num_envs and array.shape[0] <= _MAX_LENGTH
        lines += [f"{expression}.shape.dims[{k}] = {length};" for k, length in lengths[0 if is_table else 1 :]]
    return lines


def _arrays(name: str, value: Value, uses: frozenset[str], called: Sequence[Usage]) -> Iterable[tuple[str, object]]:
    """The array of a name; or of a struct, the fields that sections use or the functions that they call may use."""
    if isinstance(value, wp.array):
        yield name, value
        return
    for field_name in struct_fields(struct_of(value)):
        path = f"{name}.{field_name}"
        if path in uses or any(usage.may_use([field_name]) for usage in called):
            yield path, getattr(value, field_name)
