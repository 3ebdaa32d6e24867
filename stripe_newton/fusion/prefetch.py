# SPDX-License-Identifier: Apache-2.0
"""Prefetch: lines at the start of a generated kernel that ask for the memory of an environment, all of it at once.

Without them each section waits for its own loads. The compiler cannot move a load before the stores of earlier
sections, as both may be to the same memory for all that it knows. With them a thread waits for memory once::

    prefetch_row(reward, env)
    prefetch_row(robot.joint_pos[env], 0)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import warp as wp

from .scope import Scope
from .section import Section
from .usage import Usage, usage_of
from .warp_types import Value, struct_fields, struct_of

__all__ = ["prefetch_lines"]


def prefetch_lines(
    arguments: Sequence[str], sections: Sequence[Section], scope: Scope, called: Iterable[wp.Function], num_envs: int
) -> list[str]:
    """Lines that prefetch the row of an environment in each array with a row for each environment.

    Args:
        arguments: Names of the arrays and structs of the kernel.
        sections: The sections in it.
        scope: The arrays and structs by name.
        called: Warp functions that the sections call.
        num_envs: Number of environments.
    """
    usages = [usage_of(function) for function in called]
    uses = frozenset().union(*(section.uses for section in sections))
    lines = []
    for name in arguments:
        for expression, array in _arrays(name, scope.values[name], uses, usages):
            if isinstance(array, wp.array) and array.ptr and array.shape[0] == num_envs and array.ndim <= 2:
                row = f"{expression}, env" if array.ndim == 1 else f"{expression}[env], 0"
                lines.append(f"prefetch_row({row})")
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
