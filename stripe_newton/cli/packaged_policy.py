# SPDX-License-Identifier: Apache-2.0
"""Packaged policies: trained policies that come in the packages of their tasks, by ``register_task(policy=...)``."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

import gymnasium

from .tasks import find_task, task_ids
from .user_error import UserError

__all__ = ["packaged_policy", "tasks_with_policy"]

_KEY = "policy_entry_point"


def tasks_with_policy() -> list[str]:
    """Names of the tasks that come with a trained policy."""
    return [task for task in task_ids() if gymnasium.spec(task).kwargs.get(_KEY)]


def packaged_policy(task: str) -> Path:
    """The file of the policy that comes with a task.

    Raises:
        UserError: if there is no such task, if it has no policy, or if the package lacks the file.
    """
    entry = find_task(task).kwargs.get(_KEY)
    if not entry:
        there = ", ".join(tasks_with_policy()) or "none"
        raise UserError(f"{task}: has no policy of its own, only a training gives one; tasks with one: {there}")
    package, _, name = entry.partition(":")
    try:
        file = Path(str(importlib.resources.files(package).joinpath(name)))
    except ModuleNotFoundError:
        raise UserError(f"{task}: its policy '{entry}' is in a package that is not installed") from None
    if not file.is_file():
        raise UserError(
            f"{task}: its policy '{entry}' is not in the package; register_task(policy='package:path.onnx')"
        )
    return file
