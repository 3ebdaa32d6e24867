# SPDX-License-Identifier: Apache-2.0
"""Launcher of the ranks of a training on this host, by torch's elastic launcher; it reports why one of them failed."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
import signal
import sys
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path

from torch.distributed.elastic.multiprocessing import DefaultLogsSpecs, SignalException
from torch.distributed.elastic.multiprocessing.errors import ChildFailedError, ProcessFailure
from torch.distributed.launcher.api import LaunchConfig, elastic_launch

from stripe_newton.rl.runs.interrupt import on_first_signal

from .ranks import LAUNCHER, LostRankError

__all__ = ["launch"]


def launch(arguments: Sequence[str], count: int, user_errors: Sequence[type] = ()) -> tuple[int, str | None]:
    """Run ``python arguments`` in several processes until all have ended, or one fails, which ends the others.

    Ctrl-C, or SIGTERM, asks all of them to stop after their iteration; a second one ends them at once.

    Args:
        arguments: The arguments after ``python``.
        count: Number of processes.
        user_errors: Errors that are shown without a traceback.

    Returns:
        The exit code: 0, 2 if an error that the user can fix ended the run, else 1; and the run folder, if rank 0 has
        reported it.

    Raises:
        KeyboardInterrupt: after a second Ctrl-C.
    """
    logging.getLogger("torch.distributed.elastic").setLevel(logging.CRITICAL)  # failures are reported here
    with tempfile.TemporaryDirectory(prefix="stripe-newton-") as name:
        folder = Path(name)
        launcher = elastic_launch(_config(folder, count), sys.executable)
        code = 0
        interrupts = (signal.SIGINT, signal.SIGTERM)
        # torch's launcher would end the ranks on the first signal, so it does not get to see that.
        stop = on_first_signal(interrupts, lambda: _ask_to_stop(folder / "stop"), then=signal.default_int_handler)
        with _environment(folder, count), stop:
            try:
                launcher(*arguments)
            except ChildFailedError as error:
                code = _report(error, {kind.__name__ for kind in user_errors})
            except SignalException as ended:
                raise KeyboardInterrupt from ended
        run_folder = folder / "run_folder"
        return code, run_folder.read_text(encoding="utf-8") if run_folder.exists() else None


def _config(folder: Path, count: int) -> LaunchConfig:
    config = {
        "min_nodes": 1,
        "max_nodes": 1,
        "nproc_per_node": count,
        "run_id": uuid.uuid4().hex,
        "rdzv_backend": "c10d",
        "rdzv_endpoint": "localhost:0",
        "local_addr": "localhost",
        "max_restarts": 0,
        "logs_specs": DefaultLogsSpecs(log_dir=str(folder)),
        "signals_to_handle": "SIGHUP,SIGQUIT",
    }
    # Older versions of torch lack `signals_to_handle`.
    known = {field.name for field in dataclasses.fields(LaunchConfig)}
    return LaunchConfig(**{name: value for name, value in config.items() if name in known})  # type: ignore[arg-type]


@contextlib.contextmanager
def _environment(folder: Path, count: int) -> Iterator[None]:
    """Set the environment variables that the ranks inherit."""
    before = dict(os.environ)
    os.environ[LAUNCHER] = f"{os.getpid()}:{folder}"
    # The cores are shared out: torch in each rank would take all of them.
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // count)))
    if sys.platform == "linux":
        # All ranks are on this host. By itself gloo takes the interface of the host's name, which may lead nowhere.
        os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _ask_to_stop(stop: Path) -> None:
    stop.touch()
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


def _report(error: ChildFailedError, user_errors: set[str]) -> int:
    """Print why the run failed. Returns the exit code."""

    def order(item: tuple[int, ProcessFailure]) -> tuple[bool, bool, int]:
        # The first failure is the cause. Ranks that were ended for it, or that lost another one, are not.
        lost = _Cause.of(item[1]).kind == LostRankError.__name__
        return item[1].exitcode == -signal.SIGTERM, lost, item[1].timestamp

    rank, failure = min(error.failures.items(), key=order)
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
