# SPDX-License-Identifier: Apache-2.0
"""Starts the ranks of a training on this host by torch's elastic launcher, and tells why one of them died."""

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
from typing import Any

from torch.distributed.elastic.multiprocessing import DefaultLogsSpecs, SignalException
from torch.distributed.elastic.multiprocessing.errors import ChildFailedError, ProcessFailure
from torch.distributed.launcher.api import LaunchConfig, elastic_launch

from .distributed import LAUNCHER, LostRankError
from .interrupt import on_first_signal

__all__ = ["launch"]


def launch(arguments: Sequence[str], count: int, user_errors: Sequence[type] = ()) -> tuple[int, str | None]:
    """Run ``python arguments`` in ``count`` processes until all have ended, or one fails, which ends the others.

    Ctrl-C, or SIGTERM, asks all of them to stop after their iteration; a second one ends them at once.

    Args:
        arguments: what follows ``python``.
        count: number of processes.
        user_errors: errors that are told without a traceback.

    Returns:
        The exit code: 0, 2 if an error of the user ended the run, else 1; and the run folder, if rank 0 told it.

    Raises:
        KeyboardInterrupt: after a second Ctrl-C.
    """
    logging.getLogger("torch.distributed.elastic").setLevel(logging.CRITICAL)  # what it says is told here
    with tempfile.TemporaryDirectory(prefix="stripe-newton-") as name:
        folder = Path(name)
        config: dict[str, Any] = {
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
        known = {field.name for field in dataclasses.fields(LaunchConfig)}
        launcher = elastic_launch(LaunchConfig(**{k: v for k, v in config.items() if k in known}), sys.executable)
        code = 0
        interrupts = (signal.SIGINT, signal.SIGTERM)
        ask = on_first_signal(interrupts, lambda: _ask(folder / "stop"), then=signal.default_int_handler)
        with _environment(folder, count), ask:
            try:
                launcher(*arguments)
            except ChildFailedError as error:
                code = _report(error, {kind.__name__ for kind in user_errors})
            except SignalException as stop:
                raise KeyboardInterrupt from stop
        told = folder / "run_folder"
        return code, told.read_text(encoding="utf-8") if told.exists() else None


@contextlib.contextmanager
def _environment(folder: Path, count: int) -> Iterator[None]:
    """What the ranks inherit."""
    before = dict(os.environ)
    os.environ[LAUNCHER] = f"{os.getpid()}:{folder}"
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // count)))
    if sys.platform == "linux":
        os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _ask(stop: Path) -> None:
    stop.touch()
    print("\nstopping after this iteration (Ctrl-C again: at once)", file=sys.stderr, flush=True)


def _report(error: ChildFailedError, user_errors: set[str]) -> int:
    """Print why the run failed; returns the exit code."""

    def order(item: tuple[int, ProcessFailure]) -> tuple[bool, bool, int]:
        lost = _head(item[1]).startswith(LostRankError.__name__)
        return item[1].exitcode == -signal.SIGTERM, lost, item[1].timestamp

    rank, failure = min(error.failures.items(), key=order)
    kind, _, text = _head(failure).partition(": ")
    if kind in user_errors:
        print(f"error: {text}", file=sys.stderr)
        return 2
    if kind:
        print(_message(failure).get("extraInfo", {}).get("py_callstack", ""), file=sys.stderr)
        print(f"error: rank {rank} failed, which ended the run: {kind}: {text}", file=sys.stderr)
    elif failure.exitcode < 0:
        name = failure.signal_name()
        hint = "; is there memory enough?" if failure.exitcode == -signal.SIGKILL else ""
        print(f"error: rank {rank} was ended by {name}, which ended the run{hint}", file=sys.stderr)
    elif failure.exitcode == 2:  # a wrong option, which rank 0 has explained
        return 2
    else:
        print(f"error: rank {rank} ended with code {failure.exitcode}, which ended the run", file=sys.stderr)
    return 1


def _head(failure: ProcessFailure) -> str:
    """``KindOfError: text``, or nothing if the process left none."""
    return str(_message(failure).get("message", ""))


def _message(failure: ProcessFailure) -> dict[str, Any]:
    message: Any = failure.message  # a text, or what torch's record wrote
    return message if isinstance(message, dict) else {}
