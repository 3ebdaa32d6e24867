# SPDX-License-Identifier: Apache-2.0
"""Thread pool: one executor in a process, and another one in its forks."""

from __future__ import annotations

import threading

import pytest

from stripe_newton.thread_pool import ThreadPool
from tests.helpers.forked import run_forked


def test_threads_are_those_of_one_executor():
    pool = ThreadPool(2, "counting")
    assert pool.executor is pool.executor
    names = set(pool.executor.map(lambda _: threading.current_thread().name, range(8)))
    assert names <= {"counting_0", "counting_1"}


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # that it has threads, which is the point
def test_a_fork_has_threads_of_its_own():
    pool, meet = ThreadPool(2, "forked"), threading.Barrier(2)
    list(pool.executor.map(lambda _: meet.wait(10.0), range(2)))  # so that there are two, which are free again
    assert run_forked(lambda: sum(pool.executor.map(abs, [-3, -4]))) == 7
    assert list(pool.executor.map(abs, [-5])) == [5]
