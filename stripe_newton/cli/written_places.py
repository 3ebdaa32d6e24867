# SPDX-License-Identifier: Apache-2.0
"""Written places: options that name files and folders are tried before the work whose result goes there."""

from __future__ import annotations

import os
from pathlib import Path

from stripe_newton.output_files import try_file, try_folder, write_whole

from .user_error import UserError

__all__ = ["try_place", "write_result"]


def try_place(option: str, path: Path | None, folder: bool = False) -> None:
    """Check that the file or folder of an option can be written; None, for an option that was not given, can be.

    Raises:
        UserError: if it cannot, with the reason of the system.
    """
    if path is None:
        return
    try:
        (try_folder if folder else try_file)(path)
    except OSError as error:
        raise UserError(f"{option} {_shown(path)}: cannot be written: {error.strerror or error}") from None


def write_result(option: str, path: Path | None, text: str) -> None:
    """Write a result to the file of an option. A result that cannot be written is printed, so that it is not lost.

    Raises:
        UserError: if it could not be written.
    """
    if path is None:
        return
    try:
        write_whole(path, text)
    except OSError as error:
        print(text, end="", flush=True)
        reason = f"could not be written: {error.strerror or error}"
        raise UserError(f"{option} {_shown(path)}: {reason}; its content is printed above") from None


def _shown(path: Path) -> str:
    """The path for a message: on one line, whatever characters it has."""
    text = os.fspath(path)
    return text if text.isprintable() else repr(text)
