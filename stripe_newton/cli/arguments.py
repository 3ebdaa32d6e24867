# SPDX-License-Identifier: Apache-2.0
"""Arguments of a command: the task they name, options that are needed early, and options for config fields."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import tyro

from stripe_newton.configclass import check_types, is_config

from .field_options import Node, apply_options, options_of
from .tasks import find_task, task_argument
from .user_error import UserError

__all__ = ["parse", "peek", "task_of"]

T = TypeVar("T")


def peek(argv: Sequence[str], option: str) -> str | None:
    """The value of an option that is needed before the arguments are parsed, as other options depend on it."""
    for word, following in zip(argv, [*argv[1:], None], strict=True):
        name, equals, value = word.partition("=")
        if name == option:
            return value if equals else following
    return None


def task_of(argv: Sequence[str], command: str, options: type) -> str:
    """The task that a command's arguments name.

    Raises:
        UserError: if they name none, or an unknown one.
        SystemExit: after help, if that is asked for without a task.
    """
    task = task_argument(argv)
    if task is None and {"-h", "--help"} & set(argv):
        tyro.cli(options, args=["--help"], prog=f"stripe-newton {command}")
    if task is None:
        raise UserError(f"{command} needs a task: stripe-newton {command} TASK; 'stripe-newton list' shows all")
    find_task(task)
    return task


def parse(options: type[T], argv: Sequence[str], command: str, **configs: Node) -> T:
    """Parse a command's own options and those for the fields of its configs.

    Args:
        options: Dataclass of the command's own options.
        argv: The arguments after the command.
        command: Name of the command, for its help.
        configs: Configs by the name of their options, such as ``env``; the values are written into them.

    Returns:
        The command's own options.

    Raises:
        ConfigError: for values of configs that are not of the field's type, or out of its range, and for names of code
            that is not trusted.
    """
    # One dataclass for all options, made from the values of the configs, so that help shows them as defaults. A config
    # that no word is about is left out: it takes tyro a second to go through the hundreds of fields of a task.
    given = configs if {"-h", "--help"} & set(argv) else {n: c for n, c in configs.items() if _names_fields(argv, n)}
    nested = {name: type(options_of(cfg, name)) for name, cfg in given.items()}
    fields = [(name, kind, dataclasses.field(default_factory=kind)) for name, kind in nested.items()]
    full = dataclasses.make_dataclass("Args", fields, bases=(options,), namespace={"__doc__": options.__doc__})
    args: T = tyro.cli(full, args=argv, prog=f"stripe-newton {command}", config=(tyro.conf.FlagConversionOff,))
    for name, cfg in given.items():
        apply_options(cfg, getattr(args, name), name)
    check_types(*((name, cfg) for name, cfg in configs.items() if is_config(cfg)))
    # As by --device: a device that the command line names must be there, while one of a task's own config need not.
    device = peek(argv, "--env.sim.device")
    if device not in (None, "None") and getattr(args, "device", "") is None:
        setattr(args, "device", device)  # noqa: B010  (not every command has the option)
    return args


def _names_fields(argv: Sequence[str], config: str) -> bool:
    """Whether arguments have options for fields of a config."""
    return any(word.startswith(f"--{config}.") for word in argv)
