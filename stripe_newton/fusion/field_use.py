# SPDX-License-Identifier: Apache-2.0
"""Field use: the fields of structs that sections and other items of a step read or write.

The order of a step depends on it. For example, forward kinematics after a reset may wait for the next physics step if
no item in between uses a field that it computes.
"""

from __future__ import annotations

from collections.abc import Mapping, Set

import warp as wp

from .host_function import HostFunction
from .section import Section
from .stage import Item, KernelLaunches
from .usage import usage_of

__all__ = ["fields_used", "may_use"]


def fields_used(section: Section, functions: Mapping[str, wp.Function]) -> frozenset[str] | None:
    """Fields of structs that a section reads or writes, itself or in functions that it calls; None if unknown.

    Args:
        section: The section.
        functions: Warp functions by the names that sections call them by.
    """
    called = [usage_of(functions[name]) for name in section.uses if name in functions]
    if any(usage.unresolved for usage in called):
        return None
    own = {name.partition(".")[2] for name in section.uses if "." in name}
    return frozenset(own).union(*(usage.reads | usage.writes for usage in called))


def may_use(item: Item, fields: Set[str], functions: Mapping[str, wp.Function]) -> bool:
    """Whether an item may read or write one of some fields of structs. True if that is unknown.

    Args:
        item: The item.
        fields: Names of the fields.
        functions: Warp functions by the names that sections call them by.
    """
    if isinstance(item, HostFunction):
        return True
    used = item.fields if isinstance(item, KernelLaunches) else fields_used(item, functions)
    return used is None or not used.isdisjoint(fields)
