# SPDX-License-Identifier: Apache-2.0
"""MetricsCsv: ``metrics.csv``, one row of numbers for each iteration of a run."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import itertools
import os
import statistics
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TextIO

from stripe_newton.input_files import read_text, why_no_file

__all__ = ["MetricsCsv", "Row", "merge_rows", "read_metrics"]

_MOST_BYTES = 1 << 30
"""Largest file that is read as a whole; a row has some hundred bytes."""
_LONGEST_LINE = 1 << 20

Row = Mapping[str, float | str]
"""Values of a row by column: numbers, or their text where the row was read from the file."""


def read_metrics(path: str | os.PathLike) -> dict[str, list[float]]:
    """The columns of a ``metrics.csv``; NaN where a row has no value.

    Raises:
        ValueError: if the file is missing or has something else in it than numbers.
    """
    text = read_text(path, _MOST_BYTES)
    try:
        reader = csv.DictReader(io.StringIO(text))
        columns: dict[str, list[float]] = {name: [] for name in reader.fieldnames or ()}
        for row in reader:
            if None in row:
                raise ValueError(f"a row has more than {len(columns)} values")
            for name, values in columns.items():
                values.append(float(row[name]) if row[name] else float("nan"))
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}: is no table of numbers ({error})") from None
    return columns if any(columns.values()) else {}


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
        try:
            if os.path.lexists(self.path):
                self._keep_before(first_iteration)
                return
        except (ValueError, KeyError, csv.Error) as error:
            # A run can go on without its rows, so they are put aside rather than lost.
            aside = self.path.with_name(self.path.name + ".damaged")
            os.replace(self.path, aside)
            print(f"warning: {self.path}: {error}; it is {aside.name} now, and begins anew", file=sys.stderr)
            self.columns = ["iteration"]
        self._rewrite(())

    def _keep_before(self, first_iteration: int) -> None:
        """Drop the rows of an iteration and of later ones.

        Raises:
            ValueError: if the file is no table of this class.
        """
        reader = csv.DictReader(_whole_lines(self.path))
        columns = list(reader.fieldnames or self.columns)
        if "iteration" not in columns or len(set(columns)) < len(columns):
            raise ValueError("is damaged: its first line does not name the columns")
        self.columns = columns
        whole_rows = (row for row in reader if None not in row.values())
        self._rewrite(row for row in whole_rows if int(row["iteration"]) < first_iteration)

    def write(self, row: Row) -> None:
        """Append a row; ``row["iteration"]`` is its iteration.

        Raises:
            OSError: if it cannot be written. The row then waits, and the file is as it was.
        """
        self.waiting.append(row)
        new = list(dict.fromkeys(name for row in self.waiting for name in row if name not in self.columns))
        if new:
            rows = csv.DictReader(_whole_lines(self.path)) if self.path.exists() else ()
            self.columns += new
            try:
                self._rewrite(itertools.chain(rows, self.waiting))
            except OSError:
                self.columns = self.columns[: -len(new)]
                raise
        else:
            self._append(self._text(self.waiting))
        self.waiting = []

    def _text(self, rows: Iterable[Row], header: bool = False) -> bytes:
        text = io.StringIO(newline="")
        self._write_to(text, rows, header)
        return text.getvalue().encode()

    def _write_to(self, file: TextIO, rows: Iterable[Row], header: bool) -> None:
        writer = csv.DictWriter(file, self.columns)
        if header:
            writer.writeheader()
        writer.writerows(rows)

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

    def _rewrite(self, rows: Iterable[Row]) -> None:
        # Row by row: those of a long run are gigabytes as objects of Python.
        part = self.path.with_name(self.path.name + ".part")
        try:
            with open(part, "w", newline="", encoding="utf-8") as file:
                self._write_to(file, rows, header=True)
            os.replace(part, self.path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)


def _whole_lines(path: Path) -> Iterator[str]:
    """Lines of a text file. A last one without an end is left out: a process that was killed leaves half of one.

    Raises:
        ValueError: if it is no text file.
    """
    if problem := why_no_file(path):
        raise ValueError(problem)
    with open(path, "rb") as file:
        while line := file.readline(_LONGEST_LINE):
            if len(line) == _LONGEST_LINE:
                raise ValueError(f"is damaged: a line has more than {_LONGEST_LINE} bytes")
            try:
                text = line.decode("utf-8")
            except UnicodeDecodeError:
                raise ValueError("is damaged: it is not text") from None
            if text.endswith("\n"):
                yield text
