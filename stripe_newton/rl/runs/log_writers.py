# SPDX-License-Identifier: Apache-2.0
"""RunLogWriter and RankLogWriter: log writers for rsl_rl, to files and, in other ranks than 0, to memory."""

from __future__ import annotations

import contextlib
import sys
import threading
from pathlib import Path

import torch
from rsl_rl.utils.log_writer import LogWriter
from rsl_rl.utils.utils import resolve_class
from rsl_rl.utils.wandb_log_writer import WandbLogWriter
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import scalar

from stripe_newton.rl.errors import CheckpointWriteError

from .metrics_csv import MetricsCsv

__all__ = ["EVENTS_IN_FULL", "ROWS_IN_FULL", "RankLogWriter", "RunLogWriter"]

EVENTS_IN_FULL = 10_000
"""Iterations of which tensorboard gets each; it shows a thousand points of a curve."""
ROWS_IN_FULL = 100_000
"""Iterations of which ``metrics.csv`` has each."""


def _stride(iteration: int, in_full: int) -> int:
    """Iterations from one to the next that is written, a power of ten."""
    stride = 1
    while iteration >= in_full * stride:
        stride *= 10
    return stride


class RankLogWriter(LogWriter):
    """Collects what rsl_rl logs in a rank that writes no files, so that it can be sent to rank 0."""

    def __init__(self) -> None:
        """Begin with an empty row."""
        self._row: dict[str, float] = {}

    def add_scalar(self, tag: str, scalar_value: float | torch.Tensor, global_step: int) -> None:
        """Add one number to the row of the iteration."""
        if not tag.endswith("/time"):
            self._row[tag] = float(scalar_value)

    def take_row(self) -> dict[str, float]:
        """The numbers that were logged since the last call."""
        row, self._row = self._row, {}
        return row

    def stop(self) -> None:
        """There is nothing to close."""


class RunLogWriter(LogWriter):
    """Writes what rsl_rl logs to ``metrics.csv`` and tensorboard events, and to a second writer if there is one.

    rsl_rl also logs rewards over the seconds of the run, under tags that end in ``/time``. Only the second writer gets
    them: their step is not an iteration, so a resumed run could not tell which of them to drop, and tensorboard can
    show any curve over time by itself.

    Files stay small in runs of any length: beyond :data:`EVENTS_IN_FULL` iterations the events have every tenth one,
    beyond ten times as many every hundredth, and so on, and ``metrics.csv`` from :data:`ROWS_IN_FULL` on. Both have the
    last one of a run. The second writer gets all.
    """

    def __init__(self, log_dir: str, first_iteration: int = 0, also: dict[str, object] | None = None):
        """Open the files.

        Args:
            log_dir: The run folder.
            first_iteration: The first iteration that will be logged. What the files have of it and of later ones is
                dropped.
            also: rsl_rl's config of a second writer, ``{"class_name": ..., ...}``.

        Raises:
            CheckpointWriteError: if the files cannot be written.
        """
        self.log_dir = log_dir
        path = Path(log_dir) / "metrics.csv"
        purge = first_iteration if any(Path(log_dir).glob("events.out.tfevents.*")) else None
        try:
            self.metrics = MetricsCsv(path, first_iteration)
            self.tensorboard: SummaryWriter | None = SummaryWriter(log_dir, purge_step=purge, flush_secs=10)
        except OSError as error:
            raise CheckpointWriteError(f"{path}: could not be written: {error.strerror or error}") from error
        self.second: LogWriter | None = None
        if also is not None:
            writer_class, kwargs = resolve_class(also)
            self.second = writer_class(log_dir=log_dir, **kwargs)
        self._row: dict[str, float] = {}
        self._on_clock: list[tuple[str, float, int]] = []
        self._left_out: tuple[int, dict[str, float], dict[str, float], bool, bool] | None = None
        self._failing = False  # so that a full disk is one warning rather than one an iteration
        self._previous_hook = threading.excepthook
        threading.excepthook = self._ignore_full_disk

    def add_scalar(self, tag: str, scalar_value: float | torch.Tensor, global_step: int) -> None:
        """Add one number to the row of the iteration."""
        if tag.endswith("/time"):
            self._on_clock.append((tag, float(scalar_value), global_step))
        else:
            self._row[tag] = float(scalar_value)

    def take_row(self) -> dict[str, float]:
        """The numbers that were logged since the last call."""
        row, self._row = self._row, {}
        return row

    def end_iteration(self, iteration: int, row: dict[str, float], total_steps: int, elapsed_s: float) -> None:
        """Write the row of an iteration. A full disk is a warning; ``metrics.csv`` gets the row when there is room."""
        clock, self._on_clock = self._on_clock, []
        if self.second is not None:
            for name, value in row.items():
                self.second.add_scalar(name, value, iteration)
            # Weights & Biases takes steps in increasing order alone, and draws curves over time by itself.
            for name, value, second in () if isinstance(self.second, WandbLogWriter) else clock:
                self.second.add_scalar(name, value, second)
        head = {"iteration": iteration, "total_steps": total_steps, "elapsed_s": round(elapsed_s, 3)}
        metrics = iteration % _stride(iteration, ROWS_IN_FULL) == 0
        events = iteration % _stride(iteration, EVENTS_IN_FULL) == 0
        self._write(iteration, head, row, metrics, events)
        self._left_out = iteration, head, row, not metrics, not events

    def _write(
        self, iteration: int, head: dict[str, float], row: dict[str, float], metrics: bool, events: bool
    ) -> None:
        """Write a row to ``metrics.csv``, to the events, or to both."""
        try:
            if metrics:
                self.metrics.write(head | row)
            if events:
                self._write_events(iteration, row)
        except OSError as error:
            if not self._failing:
                file = error.filename or self.metrics.path
                print(f"\nwarning: {file}: {error.strerror or error}; the training goes on", file=sys.stderr)
            self._failing = True
            if self.tensorboard is not None and not Path(self.log_dir).is_dir():
                # Somebody has deleted the folder: the file would go on without a name.
                self.tensorboard.close()
                self.tensorboard = None
        else:
            self._failing = False

    def _write_events(self, iteration: int, row: dict[str, float]) -> None:
        try:
            if self.tensorboard is None:
                self.tensorboard = SummaryWriter(self.log_dir, flush_secs=10)
            # One event: tensorboard's thread wakes up for each, and holds the interpreter while others wait.
            values = [value for name, number in row.items() for value in scalar(name, number).value]
            self.tensorboard._get_file_writer().add_summary(Summary(value=values), iteration)
        except OSError:
            # Its thread has ended, and what it had not written is lost. The next row opens another file of events.
            self.tensorboard = None
            raise

    def store_config(self, env_cfg: dict | object, train_cfg: dict) -> None:
        """Pass the configs on to the second writer."""
        if self.second is not None:
            self.second.store_config(env_cfg, train_cfg)

    def save_model(self, model_path: str, it: int) -> None:
        """Pass a checkpoint on to the second writer."""
        if self.second is not None:
            self.second.save_model(model_path, it)

    def save_file(self, path: str) -> None:
        """Pass a file on to the second writer."""
        if self.second is not None:
            self.second.save_file(path)

    def save_video(self, video: Path, it: int) -> None:
        """Pass a video on to the second writer."""
        if self.second is not None:
            self.second.save_video(video, it)

    def stop(self) -> None:
        """Write what the last iteration has left out, and close all files."""
        if self._left_out is not None:
            self._write(*self._left_out)
        with contextlib.suppress(OSError):
            if self.tensorboard is not None:
                self.tensorboard.close()
        threading.excepthook = self._previous_hook
        if self.metrics.waiting:
            count = len(self.metrics.waiting)
            print(f"warning: {self.metrics.path}: lacks the last {count} rows, the disk is full", file=sys.stderr)
        if self.second is not None:
            self.second.stop()

    def _ignore_full_disk(self, args: threading.ExceptHookArgs) -> None:
        """Print no traceback of tensorboard's thread: its error is raised again by the next call, which warns of it."""
        if not isinstance(args.exc_value, OSError) or type(args.thread).__name__ != "_AsyncWriterThread":
            self._previous_hook(args)
