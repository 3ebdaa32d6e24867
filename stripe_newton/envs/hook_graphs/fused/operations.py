# SPDX-License-Identifier: Apache-2.0
"""Operations of chains: for each operation of ATen the plan of what it does to a row."""

from __future__ import annotations

from collections.abc import Callable

from .call import Call
from .elementwise import ELEMENTWISE
from .indexing import INDEXING
from .moving import MOVING
from .plan import Plan
from .pointwise import POINTWISE, elementwise
from .reducing import REDUCING
from .rows import Unsupported
from .trusted import require_trusted

__all__ = ["OPERATIONS", "plan"]

OPERATIONS: dict[str, Callable[[Call, int], Plan]] = {
    **dict.fromkeys(ELEMENTWISE, elementwise),
    **POINTWISE,
    **MOVING,
    **REDUCING,
    **INDEXING,
}
"""Makers of plans, by the name of the operation in ATen without the underscore of its form in place."""


def plan(call: Call, rows: int) -> Plan:
    """The plan of a call.

    Args:
        call: The call.
        rows: Number of rows.

    Raises:
        Unsupported: if it cannot be part of a chain.
    """
    make = OPERATIONS.get(call.name)
    if make is None:
        raise Unsupported("is not known")
    require_trusted(call)
    return make(call, rows)
