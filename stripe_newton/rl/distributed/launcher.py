# SPDX-License-Identifier: Apache-2.0
"""Launcher of the ranks of a training on this host; it reports why one of them failed.

The ranks meet by a file rather than a port, and send each other what is not on GPUs by the loopback interface, so that
nobody else on the network can reach them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from torch.distributed.elastic.multiprocessing.errors import ProcessFailure

from stripe_newton.rl.runs.interrupt import on_first_signal
from stripe_newton.threads import PROCESSES

from .ranks import LAUNCHER, LostRankError

__all__ = ["launch"]

_POLL_S = 0.1
_END_S = 30.0
"""Seconds that a rank has to end after SIGTERM, before it is killed."""


def launch(arguments: Sequence[str], count: int, user_errors: Sequence[type] = ()) -> tuple[int, str | None]:
    """Run ``python arguments`` in several processes until all have ended, or one fails, which ends the others.

    Ctrl-C, SIGTERM or a closed terminal asks all of them to stop after their iteration; a second signal ends them at
    once.

    Args:
        arguments: The arguments after ``python``.
        count: Number of processes.
        user_errors: Errors that are shown without a traceback.

    Returns:
        The exit code: 0, 2 if an error that the user can fix ended the run, else 1; and the run folder, if rank 0 has
        reported it.

    Raises:
        KeyboardInterrupt: after a second signal.
    """
    with tempfile.TemporaryDirectory(prefix="stripe-newton-") as name:
        folder = Path(name)
        signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        stop = on_first_signal(signals, lambda number: _ask_to_stop(folder, number), then=signal.default_int_handler)
        with _environment(folder, count), stop, _ranks(folder, arguments, count) as ranks:
            failures = _wait(folder, ranks)
        code = _report(failures, {kind.__name__ for kind in user_errors}) if failures else 0
        run_folder = folder / "run_folder"
        return code, run_folder.read_text(encoding="utf-8") if run_folder.exists() else None


@contextlib.contextmanager
def _ranks(folder: Path, arguments: Sequence[str], count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Start the ranks. At the end of the context none is left."""
    ranks: list[subprocess.Popen[bytes]] = []
    try:
        for rank in range(count):
            numbers = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": count, "LOCAL_WORLD_SIZE": count}
            # Torch's `record` writes the error of the rank to this file.
            own = {"TORCHELASTIC_ERROR_FILE": str(_error_file(folder, rank))}
            environment = os.environ | {name: str(number) for name, number in numbers.items()} | own
            # In sessions of their own: signals of the terminal go to the launcher, which passes them on by a file.
            command = [sys.executable, *arguments]
            ranks.append(subprocess.Popen(command, env=environment, start_new_session=True))
        yield ranks
    finally:
        _end(ranks)


def _wait(folder: Path, ranks: Sequence[subprocess.Popen[bytes]]) -> dict[int, ProcessFailure]:
    """Wait until all ranks have ended, or one has failed. Returns the failures by rank."""
    while True:
        codes = [rank.poll() for rank in ranks]
        failures = {
            number: ProcessFailure(number, ranks[number].pid, code, str(_error_file(folder, number)))
            for number, code in enumerate(codes)
            if code
        }
        if failures or None not in codes:
            return failures
        time.sleep(_POLL_S)


def _end(ranks: Sequence[subprocess.Popen[bytes]]) -> None:
    """End the ranks that still run, by SIGTERM, and by SIGKILL where that does not help."""
    for rank in ranks:
        rank.terminate()
    deadline = time.monotonic() + _END_S
    for rank in ranks:
        try:
            rank.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            rank.kill()
            rank.wait()


def _error_file(folder: Path, rank: int) -> Path:
    return folder / f"error_{rank}.json"


@contextlib.contextmanager
def _environment(folder: Path, count: int) -> Iterator[None]:
    """Set the environment variables that the ranks inherit."""
    before = dict(os.environ)
    os.environ[LAUNCHER] = f"{os.getpid()}:{folder}"
    os.environ[PROCESSES] = str(count)
    if sys.platform == "linux":
        # All ranks are on this host. By themselves the libraries take an interface of the network, which may lead
        # nowhere, and where anybody can connect to them.
        os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
        os.environ.setdefault("NCCL_SOCKET_IFNAME", "lo")
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _ask_to_stop(folder: Path, number: signal.Signals) -> None:
    (folder / "stop").write_text(number.name, encoding="utf-8")
    print("\nstopping after this iteration (Ctrl-C again: at once)", file=sys.stderr, flush=True)


@dataclasses.dataclass
class _Cause:
    """Error of a rank, from torch's error file; all empty if the process left none."""

    kind: str = ""
    """Name of the exception's class."""
    text: str = ""
    """Its message."""
    traceback: str = ""
    """Its traceback."""

    @classmethod
    def of(cls, failure: ProcessFailure) -> _Cause:
        """Read what torch's ``record`` wrote; anything else is a text of the launcher's own, which says nothing."""
        message: object = failure.message
        if not isinstance(message, dict):
            return cls()
        kind, _, text = str(message.get("message", "")).partition(": ")
        return cls(kind, text, str(message.get("extraInfo", {}).get("py_callstack", "")))


def _report(failures: dict[int, ProcessFailure], user_errors: set[str]) -> int:
    """Print why the run failed. Returns the exit code."""

    def order(item: tuple[int, ProcessFailure]) -> tuple[bool, bool, int]:
        # The first failure is the cause. Ranks that were ended for it, or that lost another one, are not.
        lost = _Cause.of(item[1]).kind == LostRankError.__name__
        return item[1].exitcode == -signal.SIGTERM, lost, item[1].timestamp

    rank, failure = min(failures.items(), key=order)
    cause = _Cause.of(failure)
    if cause.kind in user_errors:
        print(f"error: {cause.text}", file=sys.stderr)
        return 2
    if cause.kind:
        print(cause.traceback, file=sys.stderr)
        print(f"error: rank {rank} failed, which ended the run: {cause.kind}: {cause.text}", file=sys.stderr)
    elif failure.exitcode < 0:
        name = failure.signal_name()
        hint = "; is there enough memory?" if failure.exitcode == -signal.SIGKILL else ""
        print(f"error: rank {rank} was ended by {name}, which ended the run{hint}", file=sys.stderr)
    elif failure.exitcode == 2:  # a wrong option, which rank 0 has explained
        return 2
    else:
        print(f"error: rank {rank} ended with code {failure.exitcode}, which ended the run", file=sys.stderr)
    return 1
