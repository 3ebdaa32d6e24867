# SPDX-License-Identifier: Apache-2.0
"""Threads of torch on the CPU: as many as the work is worth, on cores that nobody else uses.

By default torch takes a thread for each core. Small networks gain nothing from that. Where others use the cores, too,
threads wait for each other, and where they wait by spinning, they take the cores from those that compute.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

__all__ = ["PROCESSES", "CoreUse", "available_cores", "choose_threads", "watch_cores"]

PROCESSES = "STRIPE_NEWTON_PROCESSES"
"""Environment variable: how many processes share the cores, such as the ranks of a training or the runs of a sweep."""

_GIVEN = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables by which users choose; torch reads them itself."""

_WORK_OF_A_THREAD = 1e8
"""Multiplications that one thread does in some milliseconds. Threads for less wait longer than they compute."""


@dataclass(frozen=True)
class CoreUse:
    """Reading of the clocks that tell how many cores are busy: two readings give the mean between them."""

    wall_s: float
    """Time of the reading [s], by ``time.monotonic``."""
    all_s: float | None
    """Time that all cores were busy since the system started [s]; None where it does not tell."""
    own_s: float
    """Time that they worked for this process [s]."""

    @classmethod
    def now(cls) -> CoreUse:
        """Read the clocks."""
        return cls(time.monotonic(), _busy_s(), time.process_time())

    def others_since(self, before: CoreUse) -> float:
        """Mean number of cores that other processes kept busy since an earlier reading."""
        elapsed = self.wall_s - before.wall_s
        if self.all_s is None or before.all_s is None or elapsed <= 0.0:
            return max(0.0, os.getloadavg()[0] - 1.0) if hasattr(os, "getloadavg") else 0.0
        return max(0.0, (self.all_s - before.all_s - (self.own_s - before.own_s)) / elapsed)


def _busy_s() -> float | None:
    """Time that the cores of this machine were busy since it started [s]; None where it does not tell (not Linux)."""
    try:
        words = Path("/proc/stat").read_text(encoding="ascii").split(maxsplit=9)
        user, nice, system, _, _, interrupts, soft = map(int, words[1:8])
    except (OSError, ValueError):
        return None
    return (user + nice + system + interrupts + soft) / os.sysconf("SC_CLK_TCK")


def available_cores() -> int:
    """Cores that this process may use: those of the machine, within its affinity and the quota of its container."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        return max(1, min(count, round(int(quota) / int(period))))
    except (OSError, ValueError):  # no such file, or "max"
        return count


_first = CoreUse.now()
"""Reading from which on the cores are watched: when this module was imported, or :func:`watch_cores` was called."""


def watch_cores() -> None:
    """Watch from now on how busy the cores are. A command does so first, and chooses when its environment is built."""
    global _first
    _first = CoreUse.now()


def choose_threads(work: float) -> int:
    """Set torch's number of threads, unless the user did by ``OMP_NUM_THREADS`` or ``MKL_NUM_THREADS``.

    There is a thread for each :data:`_WORK_OF_A_THREAD`, at least one, and no more than there are free cores: those
    that this process may use, less those that others keep busy, divided among the processes that share them.

    Args:
        work: Multiplications that are computed at once: weights of all networks times samples of a minibatch, or times
            environments where a policy only acts. 0 where no network is computed on the CPU.

    Returns:
        The number of threads.
    """
    import torch  # here, as commands read the clocks before they load it

    if not any(name in os.environ for name in _GIVEN):
        others = CoreUse.now().others_since(_first)
        torch.set_num_threads(_threads(work, available_cores(), others, _sharing()))
    return torch.get_num_threads()


def _threads(work: float, cores: int, others: float, sharing: int) -> int:
    """The number of threads for some work on some cores, of which others keep some busy."""
    # Those that share the cores are among the others, so each leaves them theirs.
    free = min(cores - others + min(others, sharing - 1), cores)
    return max(1, min(int(work / _WORK_OF_A_THREAD), round(free) // sharing))


def _sharing() -> int:
    given = os.environ.get(PROCESSES, "1")
    return int(given) if given.isdecimal() and int(given) > 0 else 1
