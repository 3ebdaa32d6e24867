# SPDX-License-Identifier: Apache-2.0
"""UserError: a command line, or code of the user, that asks for something that is not there or not possible."""

from __future__ import annotations

import importlib.util
import os
import site
import sys
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

__all__ = ["TRACEBACK", "UserError", "check_count", "user_code", "whole_module"]

TRACEBACK = "STRIPE_NEWTON_TRACEBACK"
"""Environment variable: if it is set, errors in a user's code are shown with their traceback."""
_MOST_COUNT = 2**31 - 1
"""Largest count that an option takes, as for fields of configs."""


class UserError(Exception):
    """Shown as one message without a traceback; the command ends with exit code 2."""


def check_count(option: str, value: int | None, least: int = 1) -> None:
    """Check a number of steps, episodes or the like; None is an option that was not given.

    Raises:
        UserError: if it is below ``least``, or more than a counter of 32 bits holds.
    """
    if value is not None and not least <= value <= _MOST_COUNT:
        raise UserError(f"{option} {value}: must be at least {least}" + f" and at most {_MOST_COUNT}" * (value > least))


@contextmanager
def user_code(where: str, anywhere: bool = False, otherwise: str = "") -> Iterator[None]:
    """Within this context an error that a user's code raises becomes a :class:`UserError` of one line.

    Args:
        where: What was done, for the message.
        anywhere: Also for an error that was raised below the user's code, such as by a class that it calls.
        otherwise: What to name where no line of the user's code is at fault, such as a class that is called wrongly;
            without it such an error is not changed.
    """
    try:
        yield
    except (UserError, KeyboardInterrupt, SystemExit):
        raise
    except Exception as error:
        place = None if os.environ.get(TRACEBACK) else _place(error, anywhere) or otherwise
        if not place or any(kind.__name__ == "ConfigError" for kind in type(error).__mro__):
            raise
        said = str(error).strip().partition("\n")[0]
        hint = f"{TRACEBACK}=1 shows the traceback"
        raise UserError(f"{where}: {place}: {type(error).__name__}: {said} ({hint})") from error


@contextmanager
def whole_module(what: str) -> Iterator[None]:
    """Within this context whatever ends the import of a module is a :class:`UserError`, also where no line is at fault.

    A file may be no text, ``sys.exit`` may stand at its top level, or an exception be none of Python's own kind.

    Args:
        what: The module, for the message.
    """
    try:
        yield
    except (UserError, KeyboardInterrupt):
        raise
    except SystemExit as stop:
        raise UserError(f"{what}: ends the program while it is imported (sys.exit({stop.code!r}))") from stop
    except BaseException as error:
        if os.environ.get(TRACEBACK) or any(kind.__name__ == "ConfigError" for kind in type(error).__mro__):
            raise
        said = str(error).strip().partition("\n")[0]
        hint = f"{TRACEBACK}=1 shows the traceback"
        raise UserError(f"{what} cannot be imported: {type(error).__name__}: {said} ({hint})") from error


def _place(error: Exception, anywhere: bool) -> str | None:
    """File and line of the innermost code of a user; None if there is none, or other code raised the error."""
    if isinstance(error, SyntaxError) and error.filename and _is_users(error.filename):
        return f"{_short(error.filename)}:{error.lineno}"
    frames = _frames(error.__traceback__)
    own = [(file, line) for file, line in frames if _is_users(file)]
    if not own or (frames[-1] != own[-1] and not anywhere):
        return None
    return f"{_short(own[-1][0])}:{own[-1][1]}"


def _frames(trace: TracebackType | None) -> list[tuple[str, int]]:
    return [(frame.filename, frame.lineno or 0) for frame in traceback.extract_tb(trace)]


def _short(file: str) -> str:
    """The path, relative to the working directory if it is in it."""
    path = Path(file)
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else file


def _is_users(file: str) -> bool:
    """Whether a file is neither of Python, nor of an installed package, nor of this project."""
    path = Path(file)
    return path.is_absolute() and not any(path.is_relative_to(folder) for folder in _others())


def _others() -> list[Path]:
    found = [*sysconfig.get_paths().values(), *site.getsitepackages(), sys.base_prefix]
    for name in ("stripe_newton", "stripe_kernels", "stripe_tasks"):
        spec = importlib.util.find_spec(name)
        found += list(spec.submodule_search_locations or ()) if spec is not None else []
    return [Path(folder).resolve() for folder in found]
