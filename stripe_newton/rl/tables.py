# SPDX-License-Identifier: Apache-2.0
"""Tables of text, and short names for the fields of configs, for what sweeps and comparisons print."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

__all__ = ["format_number", "format_table", "short_names"]

_NUMBER = re.compile(r"-|-?[\d.,]+(e[-+]?\d+)?( ± \S+)?")


def format_number(value: Any, digits: int = 4) -> str:
    """A number with so many significant digits, ``-`` for NaN and ``None``; anything else as it is."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, int) or (abs(value) < 1e15 and float(value).is_integer()):
        return f"{int(value):,}" if abs(value) >= 10_000 else str(int(value))
    return f"{value:,.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def format_table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Rows below a header, in columns; those of numbers are aligned to the right."""
    body = [list(row) for row in rows]
    cells = [list(header), *([format_number(value) for value in row] for row in body)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(header))]
    right = [all(_NUMBER.fullmatch(row[column]) for row in cells[1:]) for column in range(len(header))]
    lines = [
        "  ".join(text.rjust(width) if number else text.ljust(width) for text, width, number in zip(row, widths, right))
        for row in cells
    ]
    return "\n".join(line.rstrip() for line in [lines[0], "  ".join("-" * width for width in widths), *lines[1:]])


def short_names(paths: Iterable[str]) -> dict[str, str]:
    """For each dotted path its last parts, as few as tell it from the others."""
    parts = {path: path.split(".") for path in dict.fromkeys(paths)}
    names = {}
    for path, words in parts.items():
        count = 1
        while count < len(words) and any(
            other != path and others[-count:] == words[-count:] for other, others in parts.items()
        ):
            count += 1
        names[path] = ".".join(words[-count:])
    return names
