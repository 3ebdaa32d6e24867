# SPDX-License-Identifier: Apache-2.0
"""``metrics.csv`` (one row an iteration) and the log writer that fills it beside tensorboard."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

from rsl_rl.utils.log_writer import LogWriter
from rsl_rl.utils.utils import resolve_class
from rsl_rl.utils.wandb_log_writer import WandbLogWriter
from torch.utils.tensorboard import SummaryWriter

__all__ = ["MetricsCsv", "RunLogWriter", "read_metrics"]


def read_metrics(path: str | os.PathLike) -> dict[str, list[float]]:
    """The columns of a ``metrics.csv``; NaN where a row has no value."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {
        name: [float(row[name]) if row[name] else float("nan") for row in rows] for name in (rows[0] if rows else ())
    }


class MetricsCsv:
    """Rows of numbers by iteration. A column may appear late: the file is then written anew with it."""

    def __init__(self, path: str | os.PathLike, first_iteration: int = 0):
        """Open ``path``; rows that it has of ``first_iteration`` and later are dropped, the others are kept."""
        self.path = Path(path)
        self.columns = ["iteration"]
        rows: list[dict[str, Any]] = []
        if self.path.exists():
            with open(self.path, newline="", encoding="utf-8") as file:
                reader = csv.DictReader(file)
                rows = [row for row in reader if None not in row.values() and int(row["iteration"]) < first_iteration]
                self.columns = list(reader.fieldnames or self.columns)
        self._rewrite(rows)

    def write(self, row: dict[str, float]) -> None:
        """Append a row; ``row["iteration"]`` says of which iteration."""
        new = [name for name in row if name not in self.columns]
        if new:
            self._file.close()
            with open(self.path, newline="", encoding="utf-8") as file:
                rows: list[dict[str, Any]] = list(csv.DictReader(file))
            self.columns += new
            self._rewrite(rows)
        self._writer.writerow(row)
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _rewrite(self, rows: list[dict[str, Any]]) -> None:
        part = self.path.with_name(self.path.name + ".part")
        with open(part, "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(rows)
        os.replace(part, self.path)
        self._file = open(self.path, "a", newline="", encoding="utf-8")  # noqa: SIM115 (closed by close)
        self._writer = csv.DictWriter(self._file, self.columns)


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
        self.tensorboard = SummaryWriter(log_dir, purge_step=first_iteration or None, flush_secs=10)
        self.metrics = MetricsCsv(Path(log_dir) / "metrics.csv", first_iteration)
        self.second: LogWriter | None = None
        if also is not None:
            writer_class, kwargs = resolve_class(also)
            self.second = writer_class(log_dir=log_dir, **kwargs)
        self._row: dict[str, float] = {}

    def add_scalar(self, tag: str, scalar_value: Any, global_step: int) -> None:
        """Log one number of an iteration."""
        value = float(scalar_value)
        on_clock = tag.endswith("/time")
        if self.second is not None and not (on_clock and isinstance(self.second, WandbLogWriter)):
            self.second.add_scalar(tag, value, global_step)
        if not on_clock:
            self.tensorboard.add_scalar(tag, value, global_step)
            self._row[tag] = value

    def end_iteration(self, iteration: int, total_steps: int, elapsed_s: float) -> None:
        """Write the row of an iteration."""
        head = {"iteration": iteration, "total_steps": total_steps, "elapsed_s": round(elapsed_s, 3)}
        self.metrics.write(head | self._row)
        self._row = {}

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
        self.tensorboard.close()
        self.metrics.close()
        if self.second is not None:
            self.second.stop()
