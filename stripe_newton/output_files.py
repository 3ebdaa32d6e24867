# SPDX-License-Identifier: Apache-2.0
"""Output files: places are tried before the work whose result goes there, and results are written whole."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

__all__ = ["try_file", "try_folder", "write_whole"]


def try_file(path: str | os.PathLike) -> None:
    """Check that a file can be written. What is in it stays, and nothing that was not there remains.

    Raises:
        OSError: if it cannot be written, with the reason of the system.
    """
    target = _target(path)
    if target.is_dir() or target.name in ("", ".", ".."):
        raise _error(errno.EISDIR, path)
    if target.exists():
        # Without waiting: nobody may ever read from a pipe.
        os.close(os.open(target, os.O_WRONLY | os.O_NONBLOCK | os.O_APPEND))
        return
    with _folders(target.parent):
        try:
            # As it will be written: a name may be possible in a folder that takes no content.
            with open(target, "xb") as file:
                file.write(bytes(1))
        finally:
            with contextlib.suppress(OSError):
                target.unlink()


def try_folder(path: str | os.PathLike) -> None:
    """Check that files can be written to a folder, which need not exist. Nothing that was not there remains.

    Raises:
        OSError: if they cannot, with the reason of the system.
    """
    target = _target(path)
    if target.exists() and not target.is_dir():
        raise _error(errno.ENOTDIR, path)
    with _folders(target):
        try:
            with tempfile.TemporaryFile(dir=target) as file:
                file.write(bytes(1))
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None


def write_whole(path: str | os.PathLike, text: str) -> None:
    """Write a text file, with its folder: whole, or not at all where it is a regular file.

    Raises:
        OSError: if it cannot be written; a file that was there is as it was.
    """
    target = _target(path)  # a link stays a link
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists() and not target.is_file():  # a pipe or a device
        target.write_text(text, encoding="utf-8")
        return
    # Not made of the file's name, with which it might be too long.
    part = target.with_name(f".{os.getpid()}.part")
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


@contextlib.contextmanager
def _folders(path: Path) -> Iterator[None]:
    """Make folders for the time of a context."""
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _target(path: str | os.PathLike) -> Path:
    """The file that a path leads to, through all links.

    Raises:
        OSError: if it is no path, or the system cannot say.
    """
    text = os.fspath(path)
    try:
        os.stat(text)
    except FileNotFoundError:
        pass
    except ValueError:  # a null character
        raise _error(errno.EINVAL, path) from None
    # `realpath` of a loop of links is the link itself; `stat` has raised for that.
    return Path(os.path.realpath(text)) if text else Path()


def _error(number: int, path: str | os.PathLike) -> OSError:
    return OSError(number, os.strerror(number), os.fspath(path))
