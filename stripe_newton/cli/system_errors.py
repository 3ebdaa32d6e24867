# SPDX-License-Identifier: Apache-2.0
"""System errors: files that cannot be read or written, and too little memory, as one line."""

from __future__ import annotations

import errno
import os
import re

from .kernel_cache import cache_message
from .user_error import TRACEBACK

__all__ = ["system_message", "working_directory_hint"]

_NO_MEMORY = re.compile(
    r"out of memory|can't allocate memory|cannot allocate memory|failed to allocate|not enough memory|bad_alloc", re.I
)
"""Words of torch and Warp, whose errors about memory are plain RuntimeErrors."""
_UNWRITABLE = {
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.ENOTDIR, errno.ENOENT, errno.EEXIST,
    errno.ENAMETOOLONG, errno.ELOOP,
}  # fmt: skip
"""Errors of files and folders that cannot be made or written."""


def working_directory_hint() -> str:
    """What to add to a message where the working directory was deleted: no relative path can be found then."""
    try:
        os.getcwd()
    except OSError:
        return " (the working directory does not exist any more; go to another one)"
    return ""


def system_message(error: Exception) -> str | None:
    """The message for an error of the system, such as a full disk; None for any other error.

    With the environment variable of :data:`~stripe_newton.cli.user_error.TRACEBACK` it is None, too, so that the
    traceback is shown.
    """
    if os.environ.get(TRACEBACK):
        return None
    said = " ".join(str(error).split())[:200]
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and _NO_MEMORY.search(said)):
        return f"out of memory: {said or 'Python got none'}; use fewer environments (--num-envs), or a smaller scene"
    if not isinstance(error, OSError):
        return None
    if error.errno == errno.ENOMEM:
        return f"out of memory: {said}"
    if error.filename is not None and error.errno in _UNWRITABLE:
        message = cache_message(os.fsdecode(error.filename), error.strerror or said)
        if message is not None:
            return message
    place = "" if error.filename is None else f"{os.fsdecode(error.filename)!r}: "
    return f"{place}{error.strerror or said or type(error).__name__} ({TRACEBACK}=1 shows the traceback)"
