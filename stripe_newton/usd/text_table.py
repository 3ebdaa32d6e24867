# SPDX-License-Identifier: Apache-2.0
"""Text tables of at most 120 columns, and numbers and vectors as short text."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

__all__ = ["WIDTH", "count", "number", "shorten", "table", "vector"]

Row = TypeVar("Row")

WIDTH = 120
"""Most columns of a line."""
_FOLD = 40
"""Most rows that a table shows; it says how many more there are."""
_MIN_PATH, _MIN_WRAPPED = 16, 20
"""Least widths of the first column, and of a wrapped last column."""
_MAX_EXTRA_LINES = 7
"""Most lines that wrapped text takes beyond the first."""


def count(rows: Sequence[object], one: str, many: str | None = None) -> str:
    """``"1 body"``, ``"2 bodies"``."""
    return f"{len(rows)} {one if len(rows) == 1 else many or one + 's'}"


def number(value: float, digits: int = 4) -> str:
    """A number with so many significant digits; large ones with an exponent."""
    if abs(value) >= 1e6 and math.isfinite(value):
        return f"{value:.1e}"
    return f"{value + 0.0:.{digits}g}"  # + 0.0: -0.0 reads as 0


def vector(values: Sequence[float]) -> str:
    """Numbers with three digits, separated by blanks."""
    return " ".join(number(v, 3) for v in values)


def shorten(text: str, width: int) -> str:
    """The end of a text that is too long: of a path, the end says most."""
    return text if len(text) <= width else "..." + text[len(text) - width + 3 :]


def table(title: str, rows: Sequence[Row], columns: Mapping[str, Callable[[Row], str]], wrap_last: bool = False) -> str:
    """A table with a title, fitted to the page: wide columns are shortened. Empty without rows.

    Args:
        title: Written above, with the number of rows.
        rows: What the lines are made from.
        columns: Text of a cell by the header of its column. A column without header or text is left out.
        wrap_last: Wrap the text of the last column rather than shorten it.
    """
    if not rows:
        return ""
    cells = [[text(row) for text in columns.values()] for row in rows]
    header = list(columns)
    kept = [k for k in range(len(header)) if header[k] or any(row[k] for row in cells)]
    header, cells = [header[k] for k in kept], [[row[k] for k in kept] for row in cells]
    shown = [header, *cells[:_FOLD]]
    widths = _fitted([max(len(line[k]) for line in shown) for k in range(len(header))], wrap_last)
    lines = [f"{title} ({len(cells)})"]
    for line in shown:
        lines.extend(_lines(line, widths, wrap_last))
    if len(cells) > _FOLD:
        lines.append(f"  ... and {len(cells) - _FOLD} more{_kinds(cells[_FOLD:])}")
    return "\n".join(lines)


def _fitted(widths: list[int], wrap_last: bool) -> list[int]:
    """Widths of the columns, reduced until a line fits: two blanks before each column."""
    widths, room = list(widths), WIDTH - 2 - 2 * (len(widths) - 1)
    if wrap_last:
        others = sum(widths[1:-1])
        widths[0] = min(widths[0], max(_MIN_PATH, (room - others) // 2))
        widths[-1] = max(_MIN_WRAPPED, room - others - widths[0])
    while sum(widths) > room:
        widest = max(range(len(widths)), key=lambda k: widths[k])
        widths[widest] -= 1
    return widths


def _lines(line: Sequence[str], widths: Sequence[int], wrap_last: bool) -> list[str]:
    """One row as text: one line, or several where the last cell is wrapped."""
    cells = [shorten(cell, width) for cell, width in zip(line, widths, strict=True)]
    pieces = (textwrap.wrap(line[-1], widths[-1]) or [""]) if wrap_last else [cells[-1]]
    if len(pieces) > 1 + _MAX_EXTRA_LINES:
        pieces[_MAX_EXTRA_LINES] = pieces[_MAX_EXTRA_LINES][: widths[-1] - 4] + " ..."
    cells[-1] = pieces[0]
    indent = " " * (2 + sum(widths[:-1]) + 2 * (len(widths) - 1))
    first = ("  " + "  ".join(c.ljust(w) for c, w in zip(cells, widths, strict=True))).rstrip()
    return [first, *(indent + piece for piece in pieces[1 : 1 + _MAX_EXTRA_LINES])]


def _kinds(rows: list[list[str]]) -> str:
    """Counts of the second cells of the rows, if there are at most five different ones."""
    kinds = Counter(row[1] for row in rows)
    if len(kinds) > 5:
        return ""
    return ": " + ", ".join(f"{number_of} {kind}" for kind, number_of in kinds.most_common())
