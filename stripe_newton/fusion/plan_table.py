# SPDX-License-Identifier: Apache-2.0
"""Plan table: the items of a step, one a row, with their terms and the way they run, for ``env.describe()``.

::

    actions  graph, fused  actions_process: joint_effort
    physics  graph         SolverFused, 2 physics steps
    rewards  graph, fused  rewards: alive, terminating, pole_pos
"""

from __future__ import annotations

from collections.abc import Sequence

from .host_function import HostFunction
from .section import Section
from .stage import Item, Stage

__all__ = ["plan_rows", "plan_table"]


def plan_rows(stages: Sequence[Stage], captures: bool) -> list[tuple[str, str, str]]:
    """Rows of the description, one for each item: stage, item with its terms, and way of running.

    Args:
        stages: The step.
        captures: Whether runs replay CUDA graphs.
    """
    rows = []
    for stage in stages:
        for item in stage.items:
            status = _status(item, "graph" if captures else "kernel by kernel")
            if status:
                rows.append((stage.name, f"{item.name}: {', '.join(item.terms)}" if item.terms else item.name, status))
        if not stage.items:
            rows.append((stage.name, "-", "-"))
    return rows


def _status(item: Item, captured: str) -> str:
    """The way an item runs; empty for a section without lines, which does not."""
    if isinstance(item, HostFunction):
        return (item.part.status if item.part is not None else "") or f"eager: {item.reason}"
    if isinstance(item, Section):
        return f"{captured}, fused" if item.body else ""
    return captured


def plan_table(rows: Sequence[tuple[str, str, str]]) -> list[str]:
    """The rows as lines of text, in columns: stage, way of running, item."""
    first, second = (max(len(row[i]) for row in rows) for i in (0, 2))
    return [f"{stage:<{first}}  {status:<{second}}  {item}" for stage, item, status in rows]
