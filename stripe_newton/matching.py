# SPDX-License-Identifier: Apache-2.0
"""Matching of names by regular expressions: indices of names, and values by expression."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

__all__ = ["match_names", "match_values"]


def match_names(
    expressions: str | Sequence[str], names: Sequence[str], preserve_order: bool = False, what: str = "name"
) -> tuple[list[int], list[str]]:
    """Indices and names of those that fully match any of the expressions.

    Args:
        expressions: One or several regular expressions.
        names: All names.
        preserve_order: Return them in the order of the expressions rather than of ``names``.
        what: Kind of thing that is named, for the error message.

    Raises:
        ValueError: if an expression matches nothing; the message lists the names.
    """
    keys = [expressions] if isinstance(expressions, str) else list(expressions)
    found: dict[int, int] = {}
    missing = []
    for order, key in enumerate(keys):
        # fullmatch(): "leg" must not match "left_leg_joint" by accident.
        hits = [i for i, name in enumerate(names) if re.fullmatch(key, name)]
        if not hits:
            missing.append(key)
        for i in hits:
            found.setdefault(i, order)  # of several expressions, the first counts
    if missing:
        wrong = ", ".join(f"'{key}'" for key in missing)
        raise ValueError(f"{what} expression {wrong} matches nothing; there is: {', '.join(names) or 'nothing'}")
    ids = sorted(found, key=lambda i: (found[i], i) if preserve_order else (i,))
    return ids, [names[i] for i in ids]


def match_values(values: float | Mapping[str, float], names: Sequence[str], what: str = "name") -> dict[int, float]:
    """Values by index of name, from one number for all names or a mapping from expressions to numbers.

    Raises:
        ValueError: if an expression matches nothing, or two match the same name.
    """
    if not isinstance(values, Mapping):
        return {i: float(values) for i in range(len(names))}
    out: dict[int, float] = {}
    source: dict[int, str] = {}
    for key, value in values.items():
        for i in match_names(key, names, what=what)[0]:
            if i in source:  # an order of the mapping that decides would be a trap
                raise ValueError(f"{what} '{names[i]}' matches both '{source[i]}' and '{key}': make them exclusive")
            source[i], out[i] = key, float(value)
    return out
