# SPDX-License-Identifier: Apache-2.0
"""Prefetch: lines at the start of a generated kernel that ask for the memory of its environments, all of it at once.

Without them each section waits for its own loads. The compiler cannot move a load before the stores of earlier
sections, as both may be to the same memory for all that it knows. With them a thread waits for memory once.

The 32 environments of a warp have their rows one after another. Its threads ask for 32 bytes each, which is what a GPU
fetches at a time: thread 0 for the first 32 bytes of these rows, thread 1 for the next ones.
"""

from __future__ import annotations

from collections.abc import Mapping

import warp as wp

__all__ = ["PREFETCH", "prefetch_lines"]

PREFETCH = """\
auto ask = [](const void* data, int byte) {
    asm volatile("prefetch.global.L1 [%0];" ::"l"((const char*)data + byte));
};
const int lane = env & 31, first_env = env - lane;
auto ask_rows = [&](const void* data, int row, int bytes) {
    for (int k = 0; 1024 * k < bytes; ++k)
        if (1024 * k + 32 * lane < bytes) ask((const char*)data + size_t(first_env) * row, 1024 * k + 32 * lane);
};
auto ask_table = [&](const void* data, int bytes) {
    if (32 * lane < bytes) ask(data, 32 * lane);
};
"""
"""Functions in C++ that the lines call. Warp has no prefetch, so PTX says it. Nothing waits for a prefetch, whereas a
load would stall the loads behind it."""

_MAX_ROW = 512
"""Longest row of an environment that is prefetched [bytes]."""


def prefetch_lines(arrays: Mapping[str, wp.array], num_envs: int) -> list[str]:
    """Lines of C++ that prefetch the rows of a warp's environments, and the beginnings of tables that all share.

    Args:
        arrays: Arrays by the expressions that name them.
        num_envs: Number of environments.
    """
    tables, rows = [], []
    reached: dict[int, int] = {}
    """Address behind the first row of the last array, by the length of its rows."""
    # By address: positions of joints are a part of the positions of a world, whose rows hold them already.
    for expression, array in sorted(arrays.items(), key=lambda item: int(item[1].ptr)):
        row = array.strides[0]
        if array.shape[0] != num_envs:
            tables.append(f"ask_table({expression}.data, {min(array.shape[0] * row, 1024)});")
        elif row <= _MAX_ROW and array.ptr >= reached.get(row, 0):
            reached[row] = array.ptr + row
            rows.append((expression, f"    ask_rows({expression}.data, {row}, {31 * row + _width(array)});"))
    if not rows:
        return sorted(tables)
    # The last warp of a launch may have fewer environments than threads: there are no rows for the others.
    head = f"if (first_env + 32 <= {min(rows)[0]}.shape.dims[0]) {{"
    return [*sorted(tables), head, *sorted(line for _, line in rows), "}"]


def _width(array: wp.array) -> int:
    """Bytes from the beginning of a row to the end of its last element."""
    steps = ((n - 1) * stride for n, stride in zip(array.shape[1:], array.strides[1:], strict=True))
    return sum(steps) + int(wp.types.type_size_in_bytes(array.dtype))
