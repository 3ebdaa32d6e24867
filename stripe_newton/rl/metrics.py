# SPDX-License-Identifier: Apache-2.0
"""``metrics.csv`` (one row an iteration) and the log writer that fills it beside tensorboard."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import os
import statistics
import sys
import threading
from pathlib import Path
from typing import Any

from rsl_rl.utils.log_writer import LogWriter
from rsl_rl.utils.utils import resolve_class
from rsl_rl.utils.wandb_log_writer import WandbLogWriter
from torch.utils.tensorboard import SummaryWriter

from .errors import CheckpointWriteError

__all__ = ["MetricsCsv", "RankLogWriter", "RunLogWriter", "merge_rows", "read_metrics"]


def read_metrics(path: str | os.PathLike) -> dict[str, list[float]]:
    """The columns of a ``metrics.csv``; NaN where a row has no value."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {
        name: [float(row[name]) if row[name] else float("nan") for row in rows] for name in (rows[0] if rows else ())
    }


def merge_rows(rows: list[dict[str, float]]) -> dict[str, float]:
    """One row of those of several ranks: means over the ranks that have a value; of times, those of the first."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {
        name: rows[0][name]
        if name.startswith("Perf/") and name in rows[0]
        else statistics.fmean(row[name] for row in rows if name in row)
        for name in names
    }


class MetricsCsv:
    """Rows of numbers by iteration. A column may appear late: the file is then written anew with it.

    On a full disk rows wait in memory, and go to the file with the first row for which there is room again.
    """

    def __init__(self, path: str | os.PathLike, first_iteration: int = 0):
        """Open ``path``; rows that it has of ``first_iteration`` and later are dropped, the others are kept."""
        self.path = Path(path)
        self.columns = ["iteration"]
        self.waiting: list[dict[str, Any]] = []
        rows: list[dict[str, Any]] = []
        if self.path.exists():
            with open(self.path, newline="", encoding="utf-8") as file:
                whole = "".join(line for line in file if line.endswith("\n"))  # the last may have been cut short
            reader = csv.DictReader(io.StringIO(whole))
            rows = [row for row in reader if None not in row.values() and int(row["iteration"]) < first_iteration]
            self.columns = list(reader.fieldnames or self.columns)
        self._rewrite(rows)

    def write(self, row: dict[str, Any]) -> None:
        """Append a row; ``row["iteration"]`` says of which iteration.

        Raises:
            OSError: if it cannot be written; it waits, and the file is as it was.
        """
        self.waiting.append(row)
        new = list(dict.fromkeys(name for row in self.waiting for name in row if name not in self.columns))
        if new:
            with open(self.path, newline="", encoding="utf-8") as file:
                rows: list[dict[str, Any]] = list(csv.DictReader(file))
            self.columns += new
            try:
                self._rewrite(rows + self.waiting)
            except OSError:
                self.columns = self.columns[: -len(new)]
                raise
        else:
            self._append(self._text(self.waiting))
        self.waiting = []

    def _text(self, rows: list[dict[str, Any]], header: bool = False) -> bytes:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, self.columns)
        if header:
            writer.writeheader()
        writer.writerows(rows)
        return text.getvalue().encode()

    def _append(self, text: bytes) -> None:
        with open(self.path, "ab", buffering=0) as file:
            size = file.seek(0, os.SEEK_END)
            try:
                if file.write(text) != len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError:
                file.truncate(size)
                raise

    def _rewrite(self, rows: list[dict[str, Any]]) -> None:
        part = self.path.with_name(self.path.name + ".part")
        try:
            part.write_bytes(self._text(rows, header=True))
            os.replace(part, self.path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)


class RankLogWriter(LogWriter):
    """Takes what rsl_rl logs in a rank that writes no files, for rank 0."""

    def __init__(self) -> None:
        """Begin with an empty row."""
        self._row: dict[str, float] = {}

    def add_scalar(self, tag: str, scalar_value: Any, global_step: int) -> None:
        """Keep one number of an iteration."""
        if not tag.endswith("/time"):
            self._row[tag] = float(scalar_value)

    def take_row(self) -> dict[str, float]:
        """What was logged since the last call."""
        row, self._row = self._row, {}
        return row

    def stop(self) -> None:
        """Nothing is open."""


class RunLogWriter(LogWriter):
    """Writes what rsl_rl logs to tensorboard events and ``metrics.csv``, and to a second writer if there is one.

    rsl_rl also logs the reward over the seconds of the run under tags that end in ``/time``. They are left out: their
    step is not an iteration, so a resumed run could not tell which of them to drop, and tensorboard can show any
    curve over time by itself.
    """

    def __init__(self, log_dir: str, first_iteration: int = 0, also: dict[str, Any] | None = None):
        """Write into ``log_dir``; what stands there of ``first_iteration`` and later no longer counts.

        Args:
            log_dir: the run folder.
            first_iteration: the first iteration that will be logged.
            also: rsl_rl's config of a second writer, ``{"class_name": ..., ...}``.
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
        self._failing = False
        self._hook = threading.excepthook
        threading.excepthook = self._quiet_on_full_disk

    def add_scalar(self, tag: str, scalar_value: Any, global_step: int) -> None:
        """Log one number of an iteration."""
        if tag.endswith("/time"):
            self._on_clock.append((tag, float(scalar_value), global_step))
        else:
            self._row[tag] = float(scalar_value)

    def take_row(self) -> dict[str, float]:
        """What was logged since the last call."""
        row, self._row = self._row, {}
        return row

    def end_iteration(self, iteration: int, row: dict[str, float], total_steps: int, elapsed_s: float) -> None:
        """Write the row of an iteration. A full disk is warned of; ``metrics.csv`` gets the rows when there is room."""
        clock, self._on_clock = self._on_clock, []
        if self.second is not None:
            for name, value in row.items():
                self.second.add_scalar(name, value, iteration)
            for name, value, second in () if isinstance(self.second, WandbLogWriter) else clock:
                self.second.add_scalar(name, value, second)
        head = {"iteration": iteration, "total_steps": total_steps, "elapsed_s": round(elapsed_s, 3)}
        try:
            self.metrics.write(head | row)
            self._write_events(iteration, row)
        except OSError as error:
            if not self._failing:
                file = error.filename or self.metrics.path
                print(f"\nwarning: {file}: {error.strerror or error}; the training goes on", file=sys.stderr)
            self._failing = True
        else:
            self._failing = False

    def _write_events(self, iteration: int, row: dict[str, float]) -> None:
        try:
            if self.tensorboard is None:
                self.tensorboard = SummaryWriter(self.log_dir, flush_secs=10)
            for name, value in row.items():
                self.tensorboard.add_scalar(name, value, iteration)
        except OSError:
            self.tensorboard = None  # its thread has ended, and what it had not written is lost
            raise

    def store_config(self, env_cfg: dict | object, train_cfg: dict) -> None:
        """Hand the configs to the second writer."""
        if self.second is not None:
            self.second.store_config(env_cfg, train_cfg)

    def save_model(self, model_path: str, it: int) -> None:
        """Hand a checkpoint to the second writer."""
        if self.second is not None:
            self.second.save_model(model_path, it)

    def save_file(self, path: str) -> None:
        """Hand a file to the second writer."""
        if self.second is not None:
            self.second.save_file(path)

    def save_video(self, video: Path, it: int) -> None:
        """Hand a video to the second writer."""
        if self.second is not None:
            self.second.save_video(video, it)

    def stop(self) -> None:
        """Close all files."""
        with contextlib.suppress(OSError):
            if self.tensorboard is not None:
                self.tensorboard.close()
        threading.excepthook = self._hook
        if self.metrics.waiting:
            count = len(self.metrics.waiting)
            print(f"warning: {self.metrics.path}: lacks the last {count} rows, the disk is full", file=sys.stderr)
        if self.second is not None:
            self.second.stop()

    def _quiet_on_full_disk(self, args: threading.ExceptHookArgs) -> None:
        """Tensorboard's thread hands its error to the next call, which tells it."""
        if not isinstance(args.exc_value, OSError) or type(args.thread).__name__ != "_AsyncWriterThread":
            self._hook(args)
