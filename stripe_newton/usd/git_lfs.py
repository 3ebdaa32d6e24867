# SPDX-License-Identifier: Apache-2.0
"""Git LFS: pointers that stand for files which nobody has fetched."""

from __future__ import annotations

from pathlib import Path

__all__ = ["POINTER_REASON", "is_pointer"]

_BEGINNING = b"version https://git-lfs.github.com/spec/"
POINTER_REASON = "is a pointer of git LFS, not the file itself; fetch that with 'git lfs pull'"


def is_pointer(path: str | Path) -> bool:
    """Whether a file is a pointer of git LFS, as a clone without git-lfs has it."""
    try:
        with open(path, "rb") as file:
            return file.read(len(_BEGINNING)) == _BEGINNING
    except OSError as error:  # which has no name if it was raised while reading
        raise OSError(error.errno, error.strerror, str(path)) from None
