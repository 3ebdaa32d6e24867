# SPDX-License-Identifier: Apache-2.0
"""Tool ``start.py``: its clock and its table, without trainings."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from tools.benchmarks import start as tool


def test_a_phase_within_another_is_taken_out_of_it(monkeypatch):
    now = {"wall": 100.0, "processor": 3.0}
    monkeypatch.setattr(time, "perf_counter", lambda: now["wall"])
    monkeypatch.setattr(tool, "_processor_s", lambda: now["processor"])

    def work(wall: float, processor: float) -> None:
        now["wall"], now["processor"] = now["wall"] + wall, now["processor"] + processor

    def build() -> str:
        work(1.0, 0.5)
        owner.load()
        work(2.0, 1.0)
        return "built"

    owner = SimpleNamespace(build=build, load=lambda: work(4.0, 0.25))
    clock = tool.Clock()
    clock.time(owner, "build", "env")
    clock.time(owner, "load", "kernels")
    work(8.0, 2.0)
    assert owner.build() == "built"
    clock.begin("rest")
    clock.end()
    # The processor's clock began with the process.
    assert dict(clock.seconds) == {"rest": [8.0, 5.0], "env": [3.0, 1.5], "kernels": [4.0, 0.25]}


def test_the_table_has_the_smallest_time_of_each_phase():
    runs = [{"imports": [4.0, 3.0], "parse": [1.0, 0.5]}, {"imports": [5.0, 2.0], "parse": [1.5, 0.75], "rest": [1, 1]}]
    lines = tool.table(runs).splitlines()
    assert "| imports | 4.00 | 2.00 |" in lines
    assert "| **from the command to the first step** | **5.00** | **2.50** |" in lines
    assert lines[-1] == "| all | 5.00 | 2.50 |"  # the rest took no time in the first run


def test_the_phases_before_the_first_step_are_phases():
    assert set(tool.BEFORE_FIRST) < set(tool.PHASES)


@pytest.mark.parametrize("phase", ["first", "video"])
def test_what_follows_the_first_step_is_not_before_it(phase):
    assert phase not in tool.BEFORE_FIRST
