# SPDX-License-Identifier: Apache-2.0
"""FileLock: one process at a time, with a name, released by the system, also where there are no locks."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys

import pytest

from stripe_newton.file_lock import FileLock, Owner
from tests.helpers.checkout import PYTHONPATH

HOLD = """
import sys
from stripe_newton.file_lock import FileLock
lock = FileLock(sys.argv[1])
assert lock.acquire() is None
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def no_locks(monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)


def test_another_process_holds_it_until_it_is_killed(tmp_path):
    path = tmp_path / "lock"
    pipe = subprocess.PIPE
    environment = os.environ | {"PYTHONPATH": PYTHONPATH}
    with subprocess.Popen([sys.executable, "-c", HOLD, str(path)], stdin=pipe, stdout=pipe, env=environment) as other:
        assert other.stdout.readline() == b"held\n"
        lock = FileLock(path)
        owner = lock.acquire()
        assert owner.process == other.pid
        assert str(owner).startswith(f"process {other.pid} on {Owner.this().host} since 20")
        assert not lock.is_held
        other.kill()
        other.wait()
    assert path.exists()  # what a killed process leaves is no lock
    assert lock.acquire() is None
    assert FileLock(path).acquire().process == os.getpid()
    lock.release()
    lock.release()
    assert not path.exists()


def test_a_file_marks_the_owner_where_there_are_no_locks(tmp_path, capsys, no_locks):
    path = tmp_path / "lock"
    lock = FileLock(path)
    assert lock.acquire() is None
    assert FileLock(path).acquire().process == os.getpid()
    assert capsys.readouterr().err.count("has no locks; lock.owner keeps other processes out") == 1
    lock.release()
    assert not list(tmp_path.iterdir())
    # The mark of a process that has ended, and of one whose number another process has by now.
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    for process, started in ((ended.pid, ""), (os.getpid(), "1")):
        mark = Owner(process, Owner.this().host, "2026-01-31 12:00:00", started)
        (tmp_path / "lock.owner").write_text(
            f'{{"process": {mark.process}, "host": "{mark.host}", "since": "{mark.since}", "started": "{started}"}}'
        )
        assert lock.acquire() is None
        lock.release()


def test_a_damaged_mark_is_an_unknown_process(tmp_path, no_locks):
    (tmp_path / "lock.owner").write_text("{")
    assert str(FileLock(tmp_path / "lock").acquire()) == "an unknown process"
