# SPDX-License-Identifier: Apache-2.0
"""The tasks that can be named on the command line, and their configs."""

from __future__ import annotations

import difflib
import gc
import importlib
import importlib.metadata
import sys
from pathlib import Path
from typing import Any

import gymnasium

from stripe_newton.configclass import resolve_name

from .errors import UserError

__all__ = [
    "find_task",
    "import_extra",
    "import_options",
    "load_cfg",
    "load_entry_points",
    "make_env",
    "task_argument",
    "task_ids",
]

ENTRY_POINTS = "stripe_newton.tasks"
"""Entry-point group: a package that names a module here has it imported, to register its tasks with gymnasium."""

_imported: list[str] = []

_ENV_CFG, _AGENT_CFG = "env_cfg_entry_point", "rsl_rl_cfg_entry_point"


def import_extra(args: list[str]) -> list[str]:
    """Import what ``--import MODULE_OR_FILE`` names, wherever it stands; returns the other arguments.

    Modules are also looked for in the working directory.

    Raises:
        UserError: if there is nothing of that name.
    """
    rest: list[str] = []
    words = iter(args)
    for word in words:
        name, equals, value = word.partition("=")
        if name != "--import":
            rest.append(word)
            continue
        target = value if equals else next(words, "")
        if not target:
            raise UserError("--import: needs the name of a module or a file, such as my_package.tasks or my_task.py")
        _import(target)
    return rest


def import_options() -> list[str]:
    """The options ``--import`` that were given so far in this process, for commands that need the same."""
    return [word for target in _imported for word in ("--import", target)]


def _import(target: str) -> None:
    path = Path(target)
    module, folder = (path.stem, path.resolve().parent) if path.suffix == ".py" else (target, Path.cwd())
    if path.suffix == ".py" and not path.is_file():
        raise UserError(f"--import: {target} does not exist")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not (module == error.name or module.startswith(f"{error.name}.")):
            raise  # the module is there, one that it imports is not
        raise UserError(f"--import: there is no module '{target}'") from None
    if target not in _imported:
        _imported.append(target)


def load_entry_points() -> None:
    """Import the packages that name themselves, so that their tasks and scenes are registered."""
    for entry_point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        entry_point.load()


def task_ids() -> list[str]:
    """Ids of all registered tasks that have a config, sorted."""
    load_entry_points()
    return sorted(name for name, spec in gymnasium.registry.items() if _ENV_CFG in spec.kwargs)


def task_argument(args: list[str]) -> str | None:
    """The task that a command's arguments name, or None: a known one wherever it stands, else the first argument."""
    known = set(task_ids())
    named = next((word for word in args if word in known), None)
    return named or (args[0] if args and not args[0].startswith("-") else None)


def find_task(task: str) -> Any:
    """The gymnasium spec of a task.

    Raises:
        UserError: if there is none of that id, with those that look alike.
    """
    known = task_ids()
    if task not in known:
        near = difflib.get_close_matches(task, known, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else "there is none like it."
        raise UserError(f"no task '{task}'; {hint} 'stripe-newton list' shows all")
    return gymnasium.spec(task)


def load_cfg(task: str, kind: str) -> Any:
    """A new ``"env"`` or ``"agent"`` config of a task.

    Raises:
        UserError: if the task has no agent config.
    """
    name = find_task(task).kwargs.get({"env": _ENV_CFG, "agent": _AGENT_CFG}[kind])
    if name is None:
        raise UserError(f"task '{task}' is registered without '{_AGENT_CFG}', so it cannot be trained with rsl_rl")
    return (resolve_name(name) if isinstance(name, str) else name)()


def make_env(task: str, cfg: Any, render_mode: str | None = None) -> Any:
    """The vector environment of a task, made from ``cfg``; several agents are seen as one."""
    creator = find_task(task).vector_entry_point
    creator = resolve_name(creator) if isinstance(creator, str) else creator
    env = creator(cfg=cfg, render_mode=render_mode)
    if not gc.isenabled():  # see main
        gc.freeze()
        gc.enable()
    if hasattr(env.unwrapped, "possible_agents"):
        from stripe_newton.envs import multi_agent_to_single_agent

        return multi_agent_to_single_agent(env.unwrapped)
    return env
