# SPDX-License-Identifier: Apache-2.0
"""Ignored rows: what was left out, converted or replaced when a stage was read."""

from __future__ import annotations

from .text_table import count

__all__ = ["Ignored", "ignored_text", "shared_rows"]

Ignored = list[tuple[str, str, str]]
"""Rows ``(prim path, what, why)``."""
_MAX_ROWS = 20
"""Most rows that a warning shows."""


def shared_rows(rows: Ignored) -> Ignored:
    """Rows for reading: those that say the same of several prims as one, with their number."""
    places: dict[tuple[str, str], list[str]] = {}
    for path, what, why in rows:
        places.setdefault((what, why), []).append(path)
    return [
        (paths[0] + (f" (+{len(paths) - 1} more)" if len(paths) > 1 else ""), what, why)
        for (what, why), paths in places.items()
    ]


def ignored_text(file: str, rows: Ignored) -> str:
    """Rows of what was ignored or changed in a file, for a warning of at most 20 lines."""
    lines = [f"{path or file}: {what}: {why}" for path, what, why in shared_rows(rows)]
    head = f"{file}: {count(rows, 'thing')} left out, converted or replaced (scene.builder.reports lists them):"
    more = [f"... and {len(lines) - _MAX_ROWS} more"] if len(lines) > _MAX_ROWS else []
    return "\n  ".join([head, *lines[:_MAX_ROWS], *more])
