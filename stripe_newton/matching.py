# SPDX-License-Identifier: Apache-2.0
"""Matching of names by regular expressions: indices of names, and values by expression."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence

from stripe_newton.expressions import full_match, reason_of

__all__ = ["NoMatchError", "match_names", "match_values", "near_matches"]


class NoMatchError(ValueError):
    """An expression that is none, that matches no name, or that matches a name which another one matches, too."""


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
        NoMatchError: if an expression matches nothing, with the names that there are, or is no regular expression
            that can be matched in bounded time.

    Example:
        >>> match_names("left_.*", ["left_hip", "right_hip", "left_knee"])
        ([0, 2], ['left_hip', 'left_knee'])
    """
    keys = [expressions] if isinstance(expressions, str) else list(expressions)
    found: dict[int, int] = {}
    missing = []
    for order, key in enumerate(keys):
        # fullmatch(): "leg" must not match "left_leg_joint" by accident.
        try:
            hits = [i for i, name in enumerate(names) if full_match(key, name)]
        except re.error as error:
            raise NoMatchError(f"{what} expression '{key}' {reason_of(error)}") from None
        if not hits:
            missing.append(key)
        for i in hits:
            found.setdefault(i, order)  # of several expressions, the first counts
    if missing:
        wrong = ", ".join(f"'{key}'" for key in missing)
        near = list(dict.fromkeys(name for key in missing for name in near_matches(key, names)))
        hint = f"did you mean {', '.join(near)}? " if near else ""
        there = ", ".join(names) or "nothing"
        raise NoMatchError(f"{what} expression {wrong} matches nothing; {hint}there is: {there}")
    ids = sorted(found, key=lambda i: (found[i], i) if preserve_order else (i,))
    return ids, [names[i] for i in ids]


def near_matches(expression: str, names: Sequence[str], most: int = 3) -> list[str]:
    """Names that resemble an expression which matches none of them, the nearest first; at most ``most``."""
    plain = re.sub(r"[^a-z0-9]+", "", expression.lower())
    scores: dict[str, float] = {}
    for name in names:
        own = re.sub(r"[^a-z0-9]+", "", name.lower())
        # An expression such as ".*_feet" is about the end of a name, and "left.*" about its beginning.
        scores[name] = max(_likeness(plain, part) for part in (own, own[-len(plain) :], own[: len(plain)]))
    good = [name for name in sorted(scores, key=lambda n: -scores[n]) if scores[name] > 0.0]
    return good[:most]


def _likeness(one: str, two: str) -> float:
    """Share of letters that agree; 0 if too few do. Half are enough for words that begin and end alike: feet, foot."""
    share = difflib.SequenceMatcher(None, one, two).ratio()
    return share if share >= (0.5 if one and two and one[0] == two[0] and one[-1] == two[-1] else 0.6) else 0.0


def match_values(values: float | Mapping[str, float], names: Sequence[str], what: str = "name") -> dict[int, float]:
    """Values by index of name, from one number for all names or a mapping from expressions to numbers.

    Raises:
        NoMatchError: if an expression matches nothing, or two match the same name.

    Example:
        >>> match_values({".*_hip": 20.0, ".*_knee": 30.0}, ["left_hip", "right_hip", "left_knee"])
        {0: 20.0, 1: 20.0, 2: 30.0}
    """
    if not isinstance(values, Mapping):
        return {i: float(values) for i in range(len(names))}
    out: dict[int, float] = {}
    source: dict[int, str] = {}
    for key, value in values.items():
        for i in match_names(key, names, what=what)[0]:
            if i in source:  # an order of the mapping that decides would be a trap
                raise NoMatchError(f"{what} '{names[i]}' matches both '{source[i]}' and '{key}': make them exclusive")
            source[i], out[i] = key, float(value)
    return out
