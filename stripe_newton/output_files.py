# SPDX-License-Identifier: Apache-2.0
"""Output files: places are tried before the work whose result goes there, and results are written whole."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

__all__ = ["try_file", "try_folder", "write_whole"]


def try_file(path: str | os.PathLike) -> None:
    """Check that a file can be written. What is in it stays, and nothing that was not there remains.

    Raises:
        OSError: if it cannot be written, with the reason of the system.
    """
    path = Path(path)
    if _exists(path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        # Without waiting: nobody may ever read from a pipe.
        os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_APPEND))
        return
    if path.name in ("", ".", ".."):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with _folders(path.parent), open(path, "xb") as file:
        file.write(bytes(1))
        file.flush()
        path.unlink()


def try_folder(path: str | os.PathLike) -> None:
    """Check that files can be written to a folder, which need not exist. Nothing that was not there remains.

    Raises:
        OSError: if they cannot, with the reason of the system.
    """
    path = Path(path)
    with _folders(path):
        try:
            with tempfile.TemporaryFile(dir=path) as file:
                file.write(bytes(1))
                file.flush()
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None


@contextlib.contextmanager
def _folders(path: Path) -> Iterator[None]:
    """Make folders for the time of a context."""
    made = [folder for folder in (path, *path.parents) if not _exists(folder)]
    try:
        path.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _exists(path: Path) -> bool:
    """Whether there is something of this name; ValueError, for a null character, becomes an error of the system."""
    try:
        return stat.S_IFMT(os.stat(path).st_mode) != 0
    except FileNotFoundError:
        return False
    except ValueError:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL), str(path)) from None


def write_whole(path: str | os.PathLike, text: str) -> None:
    """Write a text file, with its folder: whole, or not at all where it is a regular file.

    Raises:
        OSError: if it cannot be written; a file that was there is as it was.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.is_file():  # a pipe or a device
        path.write_text(text, encoding="utf-8")
        return
    target = path.resolve()  # a link stays a link
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with open(part, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, target)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
