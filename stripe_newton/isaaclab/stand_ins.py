# SPDX-License-Identifier: Apache-2.0
"""Stand-ins: classes for names of Isaac Lab that have no effect here, or that are not supported."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

__all__ = ["StandIn", "stand_in"]


class StandIn:
    """Base of stand-ins. It takes any field, and the calls that configs have, so that files which use it load."""

    __is_configclass__ = True
    __dataclass_fields__: dict[str, Any] = {}

    def __init__(self, *args: Any, **fields: Any):
        vars(self).update(fields)

    def replace(self, **fields: Any) -> Any:
        """A copy with other values in some fields."""
        new = self.copy()
        vars(new).update(fields)
        return new

    def copy(self) -> Any:
        """A deep copy."""
        return copy.deepcopy(self)

    def to_dict(self) -> dict[str, Any]:
        """Nothing: a stand-in has no effect."""
        return {}


def stand_in(name: str, kind: str, reason: str) -> type:
    """A class of that name that takes any argument.

    Args:
        name: Name in Isaac Lab.
        kind: ``"inert"`` for what has no effect; ``"refused"`` for what is not supported, so that a config which
            uses it is refused when it is validated.
        reason: What is missing here, and what to use in its place.
    """

    def problems(self: StandIn) -> Iterator[tuple[str, str]]:
        yield "", f"{name} is not supported: {reason}"

    body: dict[str, Any] = {"__doc__": f"Stand-in for Isaac Lab's ``{name}``: {reason}.", "__module__": __name__}
    if kind == "refused":
        body["problems"] = problems
    return type(name, (StandIn,), body)
