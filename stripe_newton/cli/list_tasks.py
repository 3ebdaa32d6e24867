# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton list``: shows the tasks."""

from __future__ import annotations

import json
from dataclasses import dataclass

import gymnasium
import tyro

from .task_descriptions import describe_entry
from .tasks import task_ids

__all__ = ["description", "run"]


@dataclass
class ListArgs:
    """Show the tasks, one a line, with what each is."""

    json: bool = False
    """Print a JSON list with what each task is made of."""


def run(argv: list[str]) -> int:
    """Run the command."""
    args = tyro.cli(ListArgs, args=argv, prog="stripe-newton list")
    if args.json:
        print(json.dumps([_describe(task) for task in task_ids()], indent=2))
    else:
        described = {task: description(task) for task in task_ids()}
        width = max(map(len, described), default=0)
        print("\n".join(f"{task:<{width}}  {text}".rstrip() for task, text in described.items()))
    return 0


def description(task: str) -> str:
    """Description of a task: the one that it was registered with, else the first sentence about its config."""
    kwargs = gymnasium.spec(task).kwargs
    return str(kwargs.get("description_entry_point") or describe_entry(kwargs["env_cfg_entry_point"]))


def _describe(task: str) -> dict[str, str]:
    """Name, description, environment and configs of a task, the latter by their import paths."""
    spec = gymnasium.spec(task)
    creator = spec.vector_entry_point
    configs = {name: str(value) for name, value in spec.kwargs.items() if name.endswith("_entry_point")}
    configs.pop("description_entry_point", None)
    own = {"id": task, "description": description(task)}
    return (
        own
        | {"env": creator if isinstance(creator, str) else str(getattr(creator, "env", creator))}
        | {name.removesuffix("_entry_point"): value for name, value in configs.items()}
    )
