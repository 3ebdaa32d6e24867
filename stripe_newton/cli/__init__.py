# SPDX-License-Identifier: Apache-2.0
"""The command ``stripe-newton``. Each subcommand is a module with ``run(argv) -> int``, imported when it is called."""

from __future__ import annotations

import difflib
import gc
import importlib
import os
import sys
import time
from collections.abc import Sequence

from stripe_newton.configclass import ConfigError
from stripe_newton.rl.errors import CheckpointError, ExportError

from .errors import UserError

__all__ = ["BEGAN", "COMMANDS", "UserError", "main"]

BEGAN = time.perf_counter()
"""When the program began [s], by ``time.perf_counter``."""

COMMANDS: dict[str, tuple[str, str]] = {
    "list": ("stripe_newton.cli.list_tasks", "show the tasks, one a line"),
    "train": ("stripe_newton.cli.train", "train a policy with rsl_rl"),
    "eval": ("stripe_newton.cli.eval", "measure a trained policy over a number of episodes"),
    "export": ("stripe_newton.cli.export", "write a policy as ONNX and TorchScript, with what a robot has to know"),
    "play": ("stripe_newton.cli.play", "watch a policy, live or as a video"),
    "compare": ("stripe_newton.cli.compare", "compare runs: curves with confidence bands, a table, what differs"),
    "bench": ("stripe_newton.cli.bench", "measure what a step of a task costs, and how much of it is physics"),
    "inspect": ("stripe_newton.cli.inspect", "show what is in a USD stage or a task: tables and a picture"),
    "scene": ("stripe_newton.cli.scene", "make a scene of a spec: pictures of it, or a USD file"),
}
"""Module and one line of help of each subcommand."""

USER_ERRORS = (UserError, ConfigError, CheckpointError, ExportError)
"""What is told in one message, without a traceback."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand.

    Args:
        argv: the arguments after the program's name; by default those of the process.

    Returns:
        The exit code: 0; 2 for an error of the user; 130 after Ctrl-C. Any other error is raised.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    if argv is None:
        gc.disable()  # until the environment is built: collections double the time of the imports
    try:
        return _dispatch(args)
    except BrokenPipeError:  # whoever read the output, such as head, has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if not _is_of_the_user(error):
            raise
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except SystemExit as stop:  # raised by tyro: 0 after --help, 2 after a wrong option, which it has explained
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)


def _is_of_the_user(error: Exception) -> bool:
    usd = sys.modules.get("stripe_newton.usd")  # heavy: asked only if it is there
    return isinstance(error, USER_ERRORS) or (usd is not None and isinstance(error, usd.StageError))


def _dispatch(args: list[str]) -> int:
    from .tasks import import_extra

    args = import_extra(args)
    if not args or args[0] in ("-h", "--help"):
        print(_usage())
        return 0 if args else 2
    if args[0] not in COMMANDS:
        near = difflib.get_close_matches(args[0], COMMANDS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(COMMANDS)}"
        raise UserError(f"no command '{args[0]}'; {hint}")
    return importlib.import_module(COMMANDS[args[0]][0]).run(args[1:])


def _usage() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {text}" for name, (_, text) in COMMANDS.items()]
    return "\n".join(
        [
            "usage: stripe-newton COMMAND [options]",
            "",
            *lines,
            "",
            "stripe-newton COMMAND --help shows the options of a command; stripe-newton train TASK --help also every",
            "field of that task's configuration. --import MODULE_OR_FILE imports tasks of your own first.",
        ]
    )
