# SPDX-License-Identifier: Apache-2.0
"""Tables of text, and short names of config fields, for the output of sweeps and comparisons."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

__all__ = ["format_number", "format_table", "short_names"]

_NUMBER = re.compile(r"-|-?[\d.,]+(e[-+]?\d+)?( ± \S+)?")


def format_number(value: object, digits: int = 4) -> str:
    """A number with so many significant digits, ``-`` for NaN and ``None``; the text of all other values."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, int) or (abs(value) < 1e15 and value.is_integer()):
        return f"{int(value):,}" if abs(value) >= 10_000 else str(int(value))
    return f"{value:,.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def format_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Rows below a header, in columns; columns of numbers are aligned to the right."""
    cells = [list(header), *([format_number(value) for value in row] for row in rows)]
    columns = [_aligned(column) for column in zip(*cells)]
    rules = ["-" * len(column[0]) for column in columns]
    first, *others = [list(row) for row in zip(*columns)]
    return "\n".join("  ".join(row).rstrip() for row in [first, rules, *others])


def _aligned(column: Sequence[str]) -> list[str]:
    """The cells of a column, the header first, all of the same width."""
    width = max(map(len, column))
    is_number = all(_NUMBER.fullmatch(text) for text in column[1:])
    return [text.rjust(width) if is_number else text.ljust(width) for text in column]


_GENERAL = frozenset({"weight", "scale", "std", "func", "clip", "noise", "params", "size", "count"})
"""Last parts of paths that say nothing alone."""


def short_names(paths: Iterable[str]) -> dict[str, str]:
    """Short name of each dotted path: the fewest last parts that are unique among the paths and still clear.

    The weight of a reward or the damping of a drive needs the name of the term or the drive.
    """
    parts = {path: path.split(".") for path in dict.fromkeys(paths)}
    names = {}
    for path, words in parts.items():
        count = 2 if len(words) > 2 and (words[-1] in _GENERAL or "actuators" in words) else 1
        while count < len(words) and any(
            other != path and others[-count:] == words[-count:] for other, others in parts.items()
        ):
            count += 1
        names[path] = ".".join(words[-count:])
    return names
