# SPDX-License-Identifier: Apache-2.0
"""Threads of torch: by the work, the free cores, and the processes that share them."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from stripe_newton import threads
from stripe_newton.threads import PROCESSES, CoreUse, available_cores, choose_threads, watch_cores


@pytest.fixture(autouse=True)
def own_choice(monkeypatch):
    """Without the user's variables, and with torch's threads as they were in the end."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", PROCESSES):
        monkeypatch.delenv(name, raising=False)
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize(
    ("work", "cores", "others", "sharing", "expected"),
    [
        (5e6, 16, 0.0, 1, 1),  # a small network, whatever the machine
        (6e8, 16, 0.0, 1, 6),  # by the work
        (6e8, 2, 0.1, 1, 2),  # by the cores
        (6e8, 2, 1.0, 1, 1),  # another training runs on one of them
        (6e8, 2, 7.0, 1, 1),  # everything is busy
        (6e10, 16, 12.0, 1, 4),
        (6e10, 16, 3.0, 4, 4),  # three other runs of the same sweep: each has its share
        (6e10, 16, 7.0, 4, 3),  # and four strangers
        (6e10, 2, 3.0, 4, 1),
    ],
)
def test_threads_by_work_cores_and_others(work, cores, others, sharing, expected):
    assert threads._threads(work, cores, others, sharing) == expected


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell how busy the cores are")
def test_work_of_other_processes_counts_and_own_does_not():
    burn = "import time\nwhile time.process_time() < 0.6: pass\nprint(time.process_time())"
    before = CoreUse.now()
    burnt = float(subprocess.run([sys.executable, "-c", burn], capture_output=True, check=True, text=True).stdout)
    after = CoreUse.now()
    wall = after.wall_s - before.wall_s
    # The system counts in hundredths of a second, on each core.
    assert after.others_since(before) * wall >= burnt - 0.1
    assert after.others_since(before) * wall <= after.all_s - before.all_s


def test_torch_gets_the_number(monkeypatch):
    watch_cores()
    monkeypatch.setattr(threads, "available_cores", lambda: 64)
    monkeypatch.setattr(CoreUse, "others_since", lambda self, before: 0.0)
    assert choose_threads(0.0) == torch.get_num_threads() == 1
    assert choose_threads(3.5e8) == torch.get_num_threads() == 3
    monkeypatch.setenv(PROCESSES, "32")
    assert choose_threads(1e12) == torch.get_num_threads() == 2


@pytest.mark.parametrize("name", ["OMP_NUM_THREADS", "MKL_NUM_THREADS"])
def test_the_users_number_stays(monkeypatch, name):
    torch.set_num_threads(3)
    monkeypatch.setenv(name, "3")
    assert choose_threads(0.0) == choose_threads(1e12) == 3


def test_a_machine_has_a_core():
    assert available_cores() >= 1
