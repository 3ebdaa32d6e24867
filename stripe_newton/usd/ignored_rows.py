# SPDX-License-Identifier: Apache-2.0
"""Ignored rows: what was left out, converted or replaced when a stage was read."""

from __future__ import annotations

from .text_table import count

__all__ = ["Ignored", "ignored_text"]

Ignored = list[tuple[str, str, str]]
"""Rows ``(prim path, what, why)``."""
_MAX_ROWS = 20
"""Most rows that a warning shows."""


def ignored_text(file: str, rows: Ignored) -> str:
    """Rows of what was ignored or changed in a file, for a warning: at most 20 lines."""
    lines = [f"{path or file}: {what}: {why}" for path, what, why in rows]
    head = f"{file}: {count(rows, 'thing')} left out, converted or replaced (scene.builder.reports lists them):"
    more = [f"... and {len(lines) - _MAX_ROWS} more"] if len(lines) > _MAX_ROWS else []
    return "\n  ".join([head, *lines[:_MAX_ROWS], *more])
