# SPDX-License-Identifier: Apache-2.0
"""MetricsCsv: ``metrics.csv``, one row of numbers for each iteration of a run."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import os
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from stripe_newton.input_files import InputFileError, read_text

__all__ = ["MetricsCsv", "Row", "merge_rows", "read_metrics"]

_MOST_BYTES = 1 << 30
"""Largest file that is read; a row has some hundred bytes."""

Row = Mapping[str, float | str]
"""Values of a row by column: numbers, or their text where the row was read from the file."""


def read_metrics(path: str | os.PathLike) -> dict[str, list[float]]:
    """The columns of a ``metrics.csv``; NaN where a row has no value.

    Raises:
        ValueError: if the file is missing or has something else in it than numbers.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(read_text(path, _MOST_BYTES))))
        return {
            name: [float(row[name]) if row[name] else float("nan") for row in rows]
            for name in (rows[0] if rows else ())
        }
    except InputFileError:
        raise
    except (ValueError, TypeError, KeyError, csv.Error) as error:  # TypeError: a row with more values than columns
        raise ValueError(f"{path}: is no table of numbers ({error})") from None


def merge_rows(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Merge the rows of several ranks: means over the ranks that have a value; times are those of the first rank."""
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
        """Open or create the file.

        Args:
            path: The file.
            first_iteration: Rows of this and later iterations are dropped, earlier ones are kept.
        """
        self.path = Path(path)
        self.columns = ["iteration"]
        self.waiting: list[Row] = []
        rows: list[Row] = []
        if os.path.lexists(self.path):
            try:
                rows = self._read(first_iteration)
            except (ValueError, KeyError, csv.Error) as error:
                # A run can go on without its rows, so they are put aside rather than lost.
                aside = self.path.with_name(self.path.name + ".damaged")
                os.replace(self.path, aside)
                reason = str(error).removeprefix(f"{self.path}: ")
                print(f"warning: {self.path}: {reason}; it is {aside.name} now, and begins anew", file=sys.stderr)
        self._rewrite(rows)

    def _read(self, first_iteration: int) -> list[Row]:
        """The rows before an iteration.

        Raises:
            ValueError: if the file is no table of this class.
        """
        # A process that was killed may have left half of the last line.
        whole = read_text(self.path, _MOST_BYTES).rpartition("\n")[0]
        reader = csv.DictReader(io.StringIO(whole))
        columns = list(reader.fieldnames or self.columns)
        if "iteration" not in columns or len(set(columns)) < len(columns):
            raise ValueError("is damaged: its first line does not name the columns")
        whole_rows = [row for row in reader if None not in row.values()]
        rows: list[Row] = [row for row in whole_rows if int(row["iteration"]) < first_iteration]
        self.columns = columns
        return rows

    def write(self, row: Row) -> None:
        """Append a row; ``row["iteration"]`` is its iteration.

        Raises:
            OSError: if it cannot be written. The row then waits, and the file is as it was.
        """
        self.waiting.append(row)
        new = list(dict.fromkeys(name for row in self.waiting for name in row if name not in self.columns))
        if new:
            rows: list[Row] = []
            with contextlib.suppress(FileNotFoundError), open(self.path, newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            self.columns += new
            try:
                self._rewrite([*rows, *self.waiting])
            except OSError:
                self.columns = self.columns[: -len(new)]
                raise
        else:
            self._append(self._text(self.waiting))
        self.waiting = []

    def _text(self, rows: Sequence[Row], header: bool = False) -> bytes:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, self.columns)
        if header:
            writer.writeheader()
        writer.writerows(rows)
        return text.getvalue().encode()

    def _append(self, text: bytes) -> None:
        # Unbuffered and in one write: on a full disk part of it may be written, which is cut off again.
        with open(self.path, "ab", buffering=0) as file:
            size = file.seek(0, os.SEEK_END)
            if size == 0:  # somebody has deleted the file
                text = self._text([], header=True) + text
            try:
                if file.write(text) != len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError:
                file.truncate(size)
                raise

    def _rewrite(self, rows: Sequence[Row]) -> None:
        part = self.path.with_name(self.path.name + ".part")
        try:
            part.write_bytes(self._text(rows, header=True))
            os.replace(part, self.path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
