# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton list``: shows the tasks."""

from __future__ import annotations

import json
from dataclasses import dataclass

import gymnasium
import tyro

from .tasks import task_ids

__all__ = ["run"]


@dataclass
class ListArgs:
    """Show the tasks, one a line."""

    json: bool = False
    """Print a JSON list with what each task is made of."""


def run(argv: list[str]) -> int:
    """Run the command."""
    args = tyro.cli(ListArgs, args=argv, prog="stripe-newton list")
    if args.json:
        print(json.dumps([_describe(task) for task in task_ids()], indent=2))
    else:
        print("\n".join(task_ids()))
    return 0


def _describe(task: str) -> dict[str, str]:
    """Name, environment and configs of a task, each by its import path."""
    spec = gymnasium.spec(task)
    creator = spec.vector_entry_point
    configs = {name: str(value) for name, value in spec.kwargs.items() if name.endswith("_entry_point")}
    return {"id": task, "env": creator if isinstance(creator, str) else str(getattr(creator, "env", creator))} | {
        name.removesuffix("_entry_point"): value for name, value in configs.items()
    }
