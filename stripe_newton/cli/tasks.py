# SPDX-License-Identifier: Apache-2.0
"""Tasks of the command line: their registration, their names, their configs, their environments."""

from __future__ import annotations

import difflib
import gc
import importlib
import importlib.metadata
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal, TypeVar, overload

import gymnasium

from stripe_newton.configclass import is_config, resolve_name
from stripe_newton.rl.configs import RunnerCfg
from stripe_newton.trusted_code import trust
from stripe_newton.value_types import short

from .user_error import UserError, user_code, whole_module

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnvCfg
    from stripe_newton.rl.torch_vector_env import TorchVectorEnv

__all__ = [
    "find_task",
    "import_extra",
    "import_options",
    "import_target",
    "load_cfg",
    "load_entry_points",
    "make_env",
    "task_argument",
    "task_ids",
    "use_dialect",
]

T = TypeVar("T")

ENTRY_POINTS = "stripe_newton.tasks"
"""Entry-point group. A package that names a module here gets it imported, so that it registers its tasks."""

_imported: list[str] = []
"""Modules and files that ``--import`` named."""

_options: list[str] = []
"""``--isaaclab``, if it was given."""

_DIALECT = "--isaaclab"
"""Option: files are written for Isaac Lab."""

_ENV_CFG, _AGENT_CFG = "env_cfg_entry_point", "rsl_rl_cfg_entry_point"


# -- registration


def import_extra(args: Sequence[str]) -> list[str]:
    """Import the modules that options ``--import MODULE_OR_FILE`` name, wherever they stand.

    Modules are also looked for in the working directory.

    Returns:
        The other arguments.

    Raises:
        UserError: if there is no module or file of that name.
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


def use_dialect(args: Sequence[str]) -> list[str]:
    """Carry out ``--isaaclab`` and ``--import``: with the former, Isaac Lab's own tasks are the default of the latter.

    Returns:
        The other arguments.

    Raises:
        UserError: if there is no module or file of that name.
    """
    if _DIALECT not in args:
        return import_extra(args)
    # Here, since it loads the classes that the dialect translates.
    from stripe_newton import isaaclab
    from stripe_newton.isaaclab.registration import adopt_tasks

    isaaclab.install()
    _options.append(_DIALECT)
    given = [word for word in args if word != _DIALECT]
    rest = import_extra(given)
    if rest == given:
        _import("isaaclab_tasks")
    adopt_tasks()
    return rest


def import_options() -> list[str]:
    """The options ``--isaaclab`` and ``--import`` of this process, for processes that need the same tasks."""
    return [*dict.fromkeys(_options), *(word for target in _imported for word in ("--import", target))]


def _import(target: str) -> None:
    trust(import_target(target, "--import").__name__)
    if target not in _imported:
        _imported.append(target)


def import_target(target: str, where: str) -> ModuleType:
    """Import a module by its name, also one of the working directory, or a file by its path.

    Args:
        target: The name or path.
        where: What names it, for messages.

    Raises:
        UserError: if there is none, or it cannot be imported; with the line of the user's code that failed.
    """
    module, folder = _module_and_folder(target, where)
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    with whole_module(f"{where}: {target}"), user_code(f"{where}: {target} cannot be imported", anywhere=True):
        try:
            found = importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name is None or not (module == error.name or module.startswith(f"{error.name}.")):
                raise  # the module is there, one that it imports is not
            places = f"neither in {folder} nor in Python's path"
            raise UserError(f"{where}: there is no module '{target}', {places}") from None
    if getattr(found, "__file__", None) is None and hasattr(found, "__path__"):  # to Python a folder is a module, too
        raise UserError(f"{where}: {_empty_folder(target, Path(next(iter(found.__path__))))}")
    return found


def _empty_folder(target: str, folder: Path) -> str:
    """Message about a folder that is no package, such as one that holds a package of its name."""
    hint = f"; did you mean {target}/{folder.name}?" if (folder / folder.name / "__init__.py").is_file() else ""
    return f"{target} is a folder without __init__.py, so it has no tasks{hint}"


def _no_file(target: str, path: Path) -> str:
    """Message about a path that is no file of Python."""
    if path.is_dir():
        return _empty_folder(target.rstrip("/"), path)
    return f"{target} is no Python file: its name ends in .py" if path.exists() else f"{target} does not exist"


def _module_and_folder(target: str, where: str) -> tuple[str, Path]:
    """Name of a module, and the folder to look for it in; a path names a file, or a package by its folder."""
    path = Path(target).resolve()
    if "/" in target and (path / "__init__.py").is_file():
        path /= "__init__.py"
    elif not target.endswith(".py"):
        if "/" in target:
            raise UserError(f"{where}: {_no_file(target, path)}")
        return target, Path.cwd()
    if not path.is_file():
        raise UserError(f"{where}: {target} does not exist")
    return (path.parent.name, path.parents[1]) if path.name == "__init__.py" else (path.stem, path.parent)


def load_entry_points() -> None:
    """Import the packages of the entry-point group, so that their tasks and scenes are registered."""
    for entry_point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        entry_point.load()
        trust(entry_point.module)


# -- names


def task_ids() -> list[str]:
    """Names of all registered tasks that have a config, sorted."""
    load_entry_points()
    return sorted(name for name, spec in gymnasium.registry.items() if _ENV_CFG in spec.kwargs)


def task_argument(args: Sequence[str]) -> str | None:
    """The task that arguments name: a known task wherever it stands, else the first argument, or None."""
    known = set(task_ids())
    named = next((word for word in args if word in known), None)
    return named or (args[0] if args and not args[0].startswith("-") else None)


def find_task(task: str) -> gymnasium.envs.registration.EnvSpec:
    """The gymnasium spec of a task.

    Raises:
        UserError: if there is no such task; the message names similar ones.
    """
    known = task_ids()
    if task not in known:
        near = difflib.get_close_matches(task, known, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else "there is none like it."
        own = "a task of your own needs --import FILE_OR_MODULE"
        raise UserError(f"no task '{task}'; {hint} 'stripe-newton list' shows all; {own}")
    return gymnasium.spec(task)


# -- configs and environments


@overload
def load_cfg(task: str, kind: Literal["env"]) -> RLEnvCfg: ...


@overload
def load_cfg(task: str, kind: Literal["agent"]) -> RunnerCfg: ...


def load_cfg(task: str, kind: Literal["env", "agent"]) -> RLEnvCfg | RunnerCfg:
    """A new config of a task's environment or agent.

    Raises:
        UserError: if the task has no agent config.
    """
    entry = find_task(task).kwargs.get({"env": _ENV_CFG, "agent": _AGENT_CFG}[kind])
    if entry is None:
        raise UserError(f"task '{task}' is registered without '{_AGENT_CFG}', so it cannot be trained with rsl_rl")
    with user_code(f"the {kind} config of {task}", anywhere=True):
        make: Callable[[], RLEnvCfg | RunnerCfg] = _resolved(entry, task)
        cfg = make()
    if not is_config(cfg):
        raise UserError(f"task '{task}' is registered with a config that is {short(cfg)}, must be one of @configclass")
    return cfg


def make_env(task: str, cfg: RLEnvCfg, render_mode: str | None = None) -> TorchVectorEnv:
    """The vector environment of a task, made from ``cfg``; several agents are shown as one."""
    from .kernel_lock import compile_once  # here, as it loads Warp, which commands that build nothing do not need

    compile_once()
    with user_code(f"the environment of {task}"):
        creator: Callable[..., TorchVectorEnv] = _resolved(find_task(task).vector_entry_point, task)
        env = creator(cfg=cfg, render_mode=render_mode)
    if not gc.isenabled():  # `main` has switched it off
        # All that there is by now lives as long as the process, so no collection has to look at it.
        gc.freeze()
        gc.enable()
    # Here, since commands that build nothing should not load environments and, with them, Newton.
    from stripe_newton.envs import DirectMARLEnv, multi_agent_to_single_agent

    inner = env.unwrapped
    return multi_agent_to_single_agent(inner) if isinstance(inner, DirectMARLEnv) else env


def _resolved(entry: str | Callable[..., T], task: str) -> Callable[..., T]:
    """The object that an entry point of a task names as ``module:name``; an object itself is returned as it is.

    Raises:
        UserError: if there is no module of that name.
    """
    if not isinstance(entry, str):
        return entry
    module = entry.partition(":")[0]
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not (module == error.name or module.startswith(f"{error.name}.")):
            raise
        raise UserError(f"task '{task}' is registered with '{entry}': there is no module '{error.name}'") from None
    # After the import, whose own errors of this kind are about a line of the module.
    try:
        return resolve_name(entry)
    except AttributeError:
        raise UserError(f"task '{task}' is registered with '{entry}', which the module does not have") from None
