# SPDX-License-Identifier: Apache-2.0
"""The program ``stripe-newton``: one module for each command, with ``run(argv) -> int``, imported when it is called."""

from __future__ import annotations

import difflib
import gc
import importlib
import os
import sys
import time
from collections.abc import Sequence
from itertools import pairwise

from stripe_newton.configclass import ConfigError, NoConfigClassError
from stripe_newton.matching import NoMatchError
from stripe_newton.rl.errors import CheckpointError, DivergedError, ExportError, RanksError
from stripe_newton.threads import watch_cores

from .end_signals import EndedBySignal, begin, end_on_signals, ended_by, leave, leave_signals
from .system_errors import system_message, working_directory_hint
from .user_error import UserError
from .warning_lines import show_warnings_as_lines

__all__ = ["BEGAN", "COMMANDS", "UserError", "main"]

BEGAN = time.perf_counter()
"""Start of the program [s], by ``time.perf_counter``; ``bench`` measures from here."""

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("stripe_newton.cli.demo", "watch a trained policy that comes with its task, in a browser"),
    "list": ("stripe_newton.cli.list_tasks", "show the tasks, one a line"),
    "new": ("stripe_newton.cli.new", "make a package with a task that trains at once, and tests"),
    "train": ("stripe_newton.cli.train", "train a policy with rsl_rl"),
    "eval": ("stripe_newton.cli.eval", "measure a trained policy over a number of episodes"),
    "export": ("stripe_newton.cli.export", "write a policy as ONNX and TorchScript, with what a robot has to know"),
    "play": ("stripe_newton.cli.play", "watch a policy, live or as a video"),
    "replay-motion": ("stripe_newton.cli.replay_motion", "show recorded motions on their robot, live or as a video"),
    "report": ("stripe_newton.cli.report", "write the report of a run, or of several beside each other, as HTML"),
    "compare": ("stripe_newton.cli.compare", "compare runs: curves with confidence bands, a table, what differs"),
    "bench": ("stripe_newton.cli.bench", "measure what a step of a task costs, and how much of it is physics"),
    "inspect": ("stripe_newton.cli.inspect", "show what is in a USD stage or a task: tables and a picture"),
    "scene": ("stripe_newton.cli.scene", "make a scene of a spec: pictures of it, a USD file, or a walk through it"),
}
"""Module and line of help of each command."""

_LONGEST_ARGUMENT = 4096
"""Most characters of an argument, as of a path."""
_SIMULATES = ("train", "play", "eval", "demo", "bench")
"""Commands that build the environment of a task, for which kernels are compiled on a machine's first start."""

USER_ERRORS = (
    UserError, ConfigError, NoConfigClassError, NoMatchError, CheckpointError, DivergedError, ExportError,
    RanksError,
)  # fmt: skip
"""Errors that the user can fix: shown as one message without a traceback."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: The arguments after the program's name; by default those of the process.

    Returns:
        The exit code: 0; 2 for an error that the user can fix, and for one of the system, such as a full disk; 130
        after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP. All other errors are raised.
    """
    args, is_program = list(sys.argv[1:] if argv is None else argv), argv is None
    if is_program:
        # Until the environment is built (`make_env`): collections double the time of the imports. Not where Python
        # code calls this function, whose process goes on.
        gc.disable()
        _open_closed_streams()
        end_on_signals()
        show_warnings_as_lines()
        watch_cores()
        # Before torch is loaded: by default its threads on the CPU wait for each other by spinning. Where others use
        # the cores, too, an update of a small network took twenty times as long by that.
        os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
        # Pictures are written to files. What a notebook or a desktop names here may not be there for matplotlib.
        os.environ["MPLBACKEND"] = "agg"
    try:
        return _dispatch(args, is_program)
    except BrokenPipeError:  # the program that read the output, such as head, has ended
        # Python flushes the output once more at its end, which would raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if is_program and (number := ended_by()) is not None:  # which a library has made another error of
            leave(128 + number)
        message = str(error) if _is_user_error(error) else system_message(error)
        if message is None:
            raise
        print(f"error: {message}{working_directory_hint()}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        if is_program:
            leave(130)
        return 130
    except SystemExit as stop:  # of a signal; or of tyro: 0 after --help, 2 after a wrong option, which it explained
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        if is_program and isinstance(stop, EndedBySignal):
            leave(code)
        return code
    finally:
        if is_program:
            leave_signals()


def _open_closed_streams() -> None:
    """Open the standard streams that are closed, as by ``>&-``: the next file would get their number, and the output of
    libraries."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  (until the process ends)


def _is_user_error(error: Exception) -> bool:
    # Looked up rather than imported: they are heavy, and where they are not loaded they have raised nothing.
    heavy = (("stripe_newton.usd", "StageError"), ("stripe_newton.assets", "RobotNotFoundError"))
    found = tuple(getattr(sys.modules[module], name) for module, name in heavy if module in sys.modules)
    return isinstance(error, (*USER_ERRORS, *found))


def _dispatch(args: list[str], is_program: bool = False) -> int:
    from .tasks import use_dialect  # here, as it imports gymnasium

    for before, word in pairwise(["", *args]):
        if len(word) > _LONGEST_ARGUMENT:  # a message about it would fill the terminal
            given = f"{before} {word[:20]}...".strip() if before.startswith("-") else f"{word[:20]}..."
            raise UserError(f"{given}: has {len(word)} characters, {_LONGEST_ARGUMENT} at most")
        if not _is_text(word):  # a name of a file, which may be any bytes; torch and tensorboard take text alone
            encoding = sys.getfilesystemencoding()
            raise UserError(f"{word!r}: has bytes that are not {encoding}; rename the file or folder")
        option = word[:-1] if word.endswith("=") else before if not word else ""
        if option.startswith("--") and "." not in option:  # fields of configs may be empty texts
            raise UserError(f"{option}: the value is empty; give one, or leave the option out")
    args = use_dialect(args)
    if not args or args[0] in ("-h", "--help"):
        print(_usage())
        return 0 if args else 2
    if args[0] == "--version":
        from importlib.metadata import version  # here, as other commands start faster without it

        print(f"stripe-newton {version('stripe-newton')}")
        return 0
    if args[0] not in COMMANDS:
        near = difflib.get_close_matches(args[0], COMMANDS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(COMMANDS)}"
        raise UserError(f"no command '{args[0]}'; {hint}")
    from .early_checks import check_early, with_flag_values  # likewise, and tyro
    from .foreign_options import with_own_options

    words = with_flag_values(args[0], with_own_options(args[0], args[1:]))
    check_early(args[0], words)
    if is_program and args[0] in _SIMULATES:
        from .kernel_cache import check_cache  # here, as is all that only some commands need
        from .kernel_warmup import start_early  # processes also run that module as a program

        check_cache()
        start_early(device := _device_of(args[0], words))
        from .early_libraries import load_early  # likewise
        from .quick_imports import import_quickly

        load_early(device, words)
        import_quickly()
    command = importlib.import_module(COMMANDS[args[0]][0])
    if is_program:
        # Modules live as long as the process: neither a collection nor the end of Python has to look at them.
        gc.freeze()
    begin()
    return command.run(words)


def _is_text(word: str) -> bool:
    """Whether an argument can be written as UTF-8: one whose bytes Python could not read cannot."""
    try:
        word.encode()
    except UnicodeEncodeError:
        return False
    return True


def _device_of(command: str, words: Sequence[str]) -> str | None:
    """The device that a command's arguments name; None for its default."""
    given = [b for a, b in pairwise(words) if a == "--device"] or [
        w.partition("=")[2] for w in words if w.startswith("--device=")
    ]
    return given[-1] if given else "cpu" if command == "demo" else None


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
            "--isaaclab runs files that are written for Isaac Lab; without --import, its own package isaaclab_tasks.",
            "--version prints the version.",
        ]
    )
