# SPDX-License-Identifier: Apache-2.0
"""Early checks: help, and errors of a command line that need neither torch nor the physics to be found."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import tyro

from stripe_newton.rl.runs.run_folder import newest_run_hint

from .arguments import task_of
from .live_view import check_address
from .options import OPTIONS, PlayArgs, TrainArgs
from .tasks import task_argument
from .user_error import UserError

__all__ = ["check_early", "with_flag_values"]

_OF_TASKS = ("train", "eval", "play", "bench")
"""Commands whose first argument is a task, and that take options for the fields of its configs."""
_PATHS = ("--checkpoint", "--resume", "--sweep")
"""Options that name a file or folder that must be there."""
_DEVICE = re.compile(r"cpu|cuda(:\d+)?")
_SHORT_FOR = {
    "--num-envs": ("--env.scene.num-envs",),
    "--max-iterations": ("--agent.max-iterations",),
    "--seed": ("--agent.seed", "--env.seed"),
    "--device": ("--env.sim.device",),
    "--runner": ("--agent.runner",),
}
"""Options that are short for fields."""


def check_early(command: str, argv: Sequence[str]) -> None:
    """Check what can be checked before the command is loaded, which takes seconds.

    Raises:
        UserError: for no task, a task or file that does not exist, a device or port that is none, or options that do
            not go together.
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
            if not _exists(value):
                hint = newest_run_hint(Path(value)) if name in ("--checkpoint", "--resume") else ""
                shown = value if value.isprintable() else repr(value)
                raise UserError(f"{name} {shown}: does not exist{f'; {hint}' if hint else ''}")
    for device in _values(argv, "--device"):
        # Whether there is a GPU of that number is known when torch is loaded.
        if not _DEVICE.fullmatch(device):
            raise UserError(f"--device {device!r}: is not a device; 'cpu', 'cuda' or 'cuda:N' with its number")
    _check_named_once(argv)
    if task is not None:
        own = [task, *(word for word in _without_fields(argv) if word != task)]
        args: object = tyro.cli(
            OPTIONS[command], args=own, prog=f"stripe-newton {command}", config=(tyro.conf.FlagConversionOff,)
        )
        if isinstance(args, PlayArgs):
            args.check()
        if isinstance(args, (PlayArgs, TrainArgs)) and args.viewer == "viser":
            check_address(args.host, args.port)


def _check_named_once(argv: Sequence[str]) -> None:
    """Refuse an option beside the field that it is short for, with another value: one of them would have no effect."""
    words = [word.replace("_", "-") if word.startswith("--") else word for word in argv]
    for option, fields in _SHORT_FOR.items():
        for field in fields:
            short, long = _values(words, option)[-1:], _values(words, field)[-1:]
            if short and long and short != long:
                raise UserError(f"{option} {short[0]} is short for {field}, which is {long[0]}; give one of them")


def with_flag_values(command: str, argv: Sequence[str]) -> list[str]:
    """Arguments in which a flag, such as ``--deterministic``, has a value, as flags have among those of configs.

    Empty values of fields are joined to their option: tyro takes a lone one for a word that belongs to none.
    """
    if command not in _OF_TASKS:
        return list(argv)
    flags = {f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(OPTIONS[command]) if _is_flag(field)}
    words: list[str] = []
    for word, following in pairwise([*argv, ""]):
        lacks = word in flags and (not following or following.startswith("--"))
        if not word and words and words[-1].startswith(("--env.", "--agent.")):
            words[-1] += "="
            continue
        words += [word, "True"] if lacks else [word]
    return words


def _is_flag(field: dataclasses.Field) -> bool:
    return field.type in (bool, "bool")


def _exists(path: str) -> bool:
    try:
        return Path(path).expanduser().exists()
    except (OSError, RuntimeError):  # a name that is too long, the home of a user whom nobody knows
        return False


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
