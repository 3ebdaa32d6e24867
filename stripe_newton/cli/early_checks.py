# SPDX-License-Identifier: Apache-2.0
"""Early checks: help, and errors of a command line that need neither torch nor the physics to be found."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import tyro

from .arguments import task_of
from .options import OPTIONS, PlayArgs
from .tasks import task_argument
from .user_error import UserError

__all__ = ["check_early"]

_OF_TASKS = ("train", "eval", "play", "bench")
"""Commands whose first argument is a task, and that take options for the fields of its configs."""
_PATHS = ("--checkpoint", "--resume", "--sweep")
"""Options that name a file or folder that must be there."""


def check_early(command: str, argv: Sequence[str]) -> None:
    """Check what can be checked before the command is loaded, which takes seconds.

    Raises:
        UserError: for no task, a task or file that does not exist, or options that do not go together.
        SystemExit: after help, or for an unknown option.
    """
    if command not in OPTIONS:
        return
    wants_help, task = bool({"-h", "--help"} & set(argv)), None
    if command in _OF_TASKS:
        task = None if wants_help and task_argument(argv) is None else task_of(argv, command, OPTIONS[command])
    if wants_help and task is None:  # with a task, help shows the fields of its configs
        tyro.cli(OPTIONS[command], args=["--help"], prog=f"stripe-newton {command}")
    if wants_help:
        return
    for name in _PATHS:
        for value in _values(argv, name):
            if not Path(value).expanduser().exists():
                raise UserError(f"{name} {value}: does not exist")
    if task is not None:
        own = [task, *(word for word in _without_fields(argv) if word != task)]
        args: object = tyro.cli(
            OPTIONS[command], args=own, prog=f"stripe-newton {command}", config=(tyro.conf.FlagConversionOff,)
        )
        if isinstance(args, PlayArgs):
            args.check()


def _values(argv: Sequence[str], option: str) -> list[str]:
    following = [b for a, b in pairwise(argv) if a == option and not b.startswith("--")]
    return following + [word.partition("=")[2] for word in argv if word.startswith(f"{option}=")]


def _without_fields(argv: Sequence[str]) -> list[str]:
    """The arguments without the options for fields of configs, ``--env.*`` and ``--agent.*``, and their values."""
    words: list[str] = []
    is_field = False
    for word in argv:
        if word.startswith("--"):
            is_field = word.startswith(("--env.", "--agent."))
        if not is_field:
            words.append(word)
    return words
