# SPDX-License-Identifier: Apache-2.0
"""FileLock: a lock that the system releases when the process that holds it dies, also on network file systems.

It is ``flock``, which Linux passes on to the server of a network file system. On file systems without locks the file
itself marks the owner, which is the weaker way: a process that is killed on another host leaves it behind.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import socket
import sys
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

__all__ = ["FileLock", "Owner"]

_NO_LOCKS = {errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS, errno.EINVAL}
"""Errors of ``flock`` on file systems that have no locks."""
_told: set[str] = set()
"""Files that mark their owner, of which the user has been told."""


@dataclass(frozen=True)
class Owner:
    """A process that holds a lock."""

    process: int
    """Its number; 0 if it is unknown."""
    host: str
    """The host that it runs on."""
    since: str
    """When it took the lock."""
    started: str = ""
    """Its start in the clock of the host, which tells it from a later process of that number."""

    @classmethod
    def this(cls) -> Owner:
        """This process."""
        now = datetime.now().strftime("%Y-%m-%d %H:%M:%S")
        return cls(os.getpid(), socket.gethostname(), now, _start_of(os.getpid()))

    @classmethod
    def read(cls, path: Path) -> Owner:
        """The owner that a file names, or one that is unknown."""
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return cls(0, "", "")

    def is_dead(self) -> bool:
        """Whether the process has ended, as far as this host knows."""
        if self.host != socket.gethostname() or self.process <= 0:
            return False
        try:
            os.kill(self.process, 0)
        except ProcessLookupError:
            return True
        except PermissionError:  # it is another user's
            return False
        return bool(self.started) and _start_of(self.process) != self.started

    def __str__(self) -> str:
        return f"process {self.process} on {self.host} since {self.since}" if self.process else "an unknown process"


def _start_of(process: int) -> str:
    """Start of a process in ticks since the host's own; empty where the system does not say."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return ""
    return stat.rpartition(")")[2].split()[19]  # the name before it may have spaces


class FileLock:
    """A lock on a file, which names its owner while it is held and is removed with the lock."""

    def __init__(self, path: str | os.PathLike):
        """``path``: the file; its folder must exist."""
        self.path = Path(path)
        self._descriptor: int | None = None
        self._marked = False

    @property
    def is_held(self) -> bool:
        """Whether this object holds the lock."""
        return self._descriptor is not None or self._marked

    @property
    def descriptor(self) -> int | None:
        """The open file, whose lock processes that inherit it share; None where the file system has no locks."""
        return self._descriptor

    def acquire(self) -> Owner | None:
        """Take the lock, without waiting.

        Returns:
            None, or the process that holds it.

        Raises:
            OSError: if the file cannot be written.
        """
        while True:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if self._is_file_of(descriptor):
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, _text(Owner.this()), 0)
                    self._descriptor = descriptor
                    return None
                # Its owner has removed it between the two calls: another file has the name now.
            except OSError as error:
                if error.errno in _NO_LOCKS:
                    return self._mark()
                if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                    return Owner.read(self.path)
                raise
            finally:
                # Also when a signal ends the process here: a lock that nobody gives back stops its other threads.
                if self._descriptor != descriptor:
                    os.close(descriptor)

    def _is_file_of(self, descriptor: int) -> bool:
        with contextlib.suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(descriptor), os.stat(self.path, follow_symlinks=False))
        return False

    def _mark(self) -> Owner | None:
        """Take the lock by a file that exists, where there are no locks."""
        mark = self._mark_path
        if str(mark) not in _told:
            _told.add(str(mark))
            text = f"warning: the file system of {self.path.parent} has no locks; {mark.name} keeps other processes out"
            print(f"{text}. Delete it if the process that it names is gone", file=sys.stderr)
        for _ in range(2):
            try:
                descriptor = os.open(mark, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
            except FileExistsError:
                owner = Owner.read(mark)
                if not owner.is_dead():
                    return owner
                mark.unlink(missing_ok=True)
                continue
            os.write(descriptor, _text(Owner.this()))
            os.close(descriptor)
            self._marked = True
            return None
        return Owner.read(mark)

    @property
    def _mark_path(self) -> Path:
        return self.path.with_name(f"{self.path.name}.owner")

    def release(self) -> None:
        """Give the lock back; without it this does nothing."""
        if self._descriptor is not None:
            # First the name, while the lock is still held: who opens it now gets another file.
            if self._is_file_of(self._descriptor):
                with contextlib.suppress(OSError):
                    self.path.unlink()
            os.close(self._descriptor)
            self._descriptor = None
        if self._marked:
            self._marked = False
            for path in (self._mark_path, self.path):
                with contextlib.suppress(OSError):
                    path.unlink()


def _text(owner: Owner) -> bytes:
    return json.dumps(asdict(owner)).encode()
