# SPDX-License-Identifier: Apache-2.0
"""Warning lines: on the command line a warning is one line of text, shown once."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

__all__ = ["show_warnings_as_lines"]

_PACKAGE = str(Path(__file__).parents[1])
"""Folder of the package, whose warnings name what they are about themselves."""


def show_warnings_as_lines() -> None:
    """Show the package's own warnings as ``warning: TEXT``, without file and line of its source, and each text once.

    Python repeats a warning after each ``warnings.catch_warnings()`` of any library. Warnings of other packages and of
    a user's code keep Python's form, which names their place.
    """
    warnings.showwarning = _Lines(warnings.showwarning)


class _Lines:
    """A ``warnings.showwarning`` that shows equal warnings once."""

    def __init__(self, otherwise: Callable[..., None]):
        self._otherwise, self._shown = otherwise, set[tuple[str, str]]()

    def __call__(
        self,
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        key = (category.__name__, str(message))
        if key in self._shown:
            return
        self._shown.add(key)
        if issubclass(category, UserWarning) and filename.startswith(_PACKAGE):
            print(f"warning: {message}", file=file or sys.stderr, flush=True)
        else:
            self._otherwise(message, category, filename, lineno, file, line)
