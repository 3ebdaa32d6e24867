# SPDX-License-Identifier: Apache-2.0
"""Log files of a run: all of a usual training, thinned in a very long one, with its last iteration."""

from __future__ import annotations

import tracemalloc

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from stripe_newton.rl import read_metrics
from stripe_newton.rl.runs import log_writers
from stripe_newton.rl.runs.log_writers import RunLogWriter
from stripe_newton.rl.runs.metrics_csv import MetricsCsv


def log(folder, first: int, end: int) -> None:
    writer = RunLogWriter(str(folder), first)
    for iteration in range(first, end):
        writer.end_iteration(iteration, {"Loss/value": 0.5 * iteration}, 100 * iteration, 1.0)
    writer.stop()


def logged(folder) -> tuple[list[int], list[int]]:
    """Iterations in ``metrics.csv`` and in the events."""
    columns = read_metrics(folder / "metrics.csv")
    assert columns["Loss/value"] == [0.5 * iteration for iteration in columns["iteration"]]
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    return [int(n) for n in columns["iteration"]], [event.step for event in events.Scalars("Loss/value")]


def test_long_runs_leave_iterations_out(tmp_path, monkeypatch):
    monkeypatch.setattr(log_writers, "ROWS_IN_FULL", 20)
    monkeypatch.setattr(log_writers, "EVENTS_IN_FULL", 10)
    log(tmp_path, 0, 236)
    rows, events = logged(tmp_path)
    assert rows == [*range(20), *range(20, 200, 10), 200, 235]
    assert events == [*range(10), *range(10, 100, 10), 100, 200, 235]
    log(tmp_path, 215, 301)  # resumed from an earlier checkpoint
    rows, events = logged(tmp_path)
    assert rows[-3:] == [190, 200, 300]
    assert events[-3:] == [100, 200, 300]


def test_usual_runs_are_logged_in_full(tmp_path):
    log(tmp_path, 0, 50)
    assert logged(tmp_path) == ([*range(50)], [*range(50)])
    assert log_writers._stride(9_999, log_writers.EVENTS_IN_FULL) == 1
    assert log_writers._stride(99_999, log_writers.ROWS_IN_FULL) == 1


def test_a_large_file_is_taken_over_row_by_row(tmp_path):
    path, count = tmp_path / "metrics.csv", 40_000
    names = [f"name{n}" for n in range(20)]
    with open(path, "w") as file:
        file.write(",".join(["iteration", *names]) + "\n")
        file.writelines(",".join(map(str, [row, *range(100, 120)])) + "\n" for row in range(count))
        file.write("40000,1")  # half a row, of a process that was killed
    tracemalloc.start()
    metrics = MetricsCsv(path, count - 1)
    metrics.write({"iteration": count - 1, "late": 7.0})  # a column more: all rows are written anew
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert path.stat().st_size > 3e6
    assert most < 2e6
    columns = read_metrics(path)
    assert columns["iteration"] == [float(n) for n in range(count)]
    assert columns["name19"][:-1] == [119.0] * (count - 1)
    assert columns["late"][-1] == 7.0


@pytest.mark.parametrize(
    "content", [b"x" * 3_000_000, b"iteration,a\n\xff\xfe\n", b'iteration,a\n"' + b"x" * 200_000 + b"\n"]
)
def test_damaged_files_are_put_aside(tmp_path, capsys, content):
    path = tmp_path / "metrics.csv"
    path.write_bytes(content)
    MetricsCsv(path, 5).write({"iteration": 5})
    assert read_metrics(path) == {"iteration": [5.0]}
    assert (tmp_path / "metrics.csv.damaged").read_bytes() == content
    assert "warning" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.part"))
