# SPDX-License-Identifier: Apache-2.0
"""Kernel cache: the folder of compiled kernels, without importing Warp, and what to do where it cannot be written."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path

from stripe_newton.output_files import try_folder

from .user_error import UserError

__all__ = ["cache_folder", "cache_message", "check_cache", "is_read_only"]

_VARIABLES = ("WARP_CACHE_PATH", "XDG_CACHE_HOME", "HOME")
"""Environment variables that say where the cache is; the first that is set does."""
_CURE = "set WARP_CACHE_PATH to a folder that can be"


def cache_folder() -> Path | None:
    """Warp's kernel cache; None where its place is not known."""
    version = importlib.metadata.version("warp-lang")
    if given := os.environ.get("WARP_CACHE_PATH"):
        return Path(os.path.realpath(given)) / version
    try:
        if platform.system() == "Linux":
            return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "warp" / version
        return Path.home() / "Library" / "Caches" / "warp" / version if platform.system() == "Darwin" else None
    except RuntimeError:  # a user whose home nobody knows
        return None


def is_read_only(folder: Path) -> bool:
    """Whether nothing can be compiled into a cache, as in a container whose cache was filled when it was built."""
    return folder.exists() and not os.access(folder, os.W_OK)


def check_cache() -> None:
    """Check that there is a cache, or that it can be made. One that cannot be written may have all that is needed.

    Raises:
        UserError: if it can neither be written nor has anything.
    """
    folder = cache_folder()
    if folder is None:
        return
    try:
        if not folder.is_dir() or not any(folder.iterdir()):
            try_folder(folder)
    except OSError as error:
        raise UserError(cache_message(folder, error.strerror or str(error))) from None


def cache_message(place: str | os.PathLike, reason: str) -> str | None:
    """The message for a file or folder that cannot be written; None if it has nothing to do with the cache.

    Args:
        place: The file or folder: the cache, one in it, or one of the folders above it, which are made for it.
        reason: The reason of the system.
    """
    folder = cache_folder()
    if folder is None:
        return None
    try:
        path = Path(os.path.abspath(place))
    except FileNotFoundError:  # a relative place, and the working directory is gone
        return None
    is_on_the_way = folder.is_relative_to(path) and not os.path.isdir(folder)
    if not (is_on_the_way or path.is_relative_to(folder)):
        return None
    given = [f" ({name}={os.environ[name]})" for name in _VARIABLES if os.environ.get(name)]
    return f"the folder of compiled kernels, {folder}{''.join(given[:1])}, cannot be written: {reason}; {_CURE}"
