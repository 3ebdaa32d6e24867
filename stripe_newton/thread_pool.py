# SPDX-License-Identifier: Apache-2.0
"""Thread pool: threads for work in native code, which a forked process starts anew."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

__all__ = ["ThreadPool"]


class ThreadPool:
    """A ``ThreadPoolExecutor`` that is made at its first use, once in each process.

    A process that is forked has the executor of its parent, which counts on threads that did not come along: what is
    submitted to it never ends.
    """

    def __init__(self, max_threads: int, name: str):
        """Start no thread yet.

        Args:
            max_threads: Most threads.
            name: Prefix of their names.
        """
        self._max_threads, self._name = max_threads, name
        self._executor: ThreadPoolExecutor | None = None
        self._process = 0

    @property
    def executor(self) -> ThreadPoolExecutor:
        """The executor of this process."""
        if self._executor is None or self._process != os.getpid():
            self._executor = ThreadPoolExecutor(self._max_threads, thread_name_prefix=self._name)
            self._process = os.getpid()
        return self._executor
