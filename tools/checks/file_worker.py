# SPDX-License-Identifier: Apache-2.0
"""File worker: tries files in a process that may crash or hang, one after the other, and says how each ended."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

__all__ = ["BAD", "Answer", "FileWorker", "answer_each_line", "try_files"]

BAD = ("traceback", "crash", "hang")
"""Outcomes that must not be."""
START_S = 60.0
"""Seconds more for the first file of a process, which pays for its imports and kernels too."""


@dataclass
class Answer:
    """How a file ended."""

    outcome: str
    """What the trial says, or ``crash`` or ``hang``."""
    text: str
    """A line of the trial, the signal, or the time."""
    seconds: float
    """How long it took."""
    facts: dict[str, Any]
    """Whatever else the trial says."""


def answer_each_line(trial: Callable[[str], tuple[str, str, dict[str, Any]]]) -> None:
    """Try the files named on standard input, one a line, and print a line of JSON for each."""
    import warnings

    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin:
        print(json.dumps(trial(line.strip())), file=answers, flush=True)


class FileWorker:
    """A process that tries files one after the other; started anew after a crash and after a hang.

    Args:
        command: Starts a process that runs :func:`answer_each_line`.
        timeout: Seconds that a file may take.
    """

    def __init__(self, command: list[str], timeout: float):
        self._command, self._timeout = command, timeout
        self._process: subprocess.Popen[str] | None = None
        self._fresh = True

    def try_file(self, path: str) -> Answer:
        """Try one file."""
        if self._process is None:
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(
                self._command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True
            )
            self._fresh = True
        process, start = self._process, time.monotonic()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(path + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], self._timeout + (START_S if self._fresh else 0.0))
        self._fresh = False
        line = process.stdout.readline() if ready else ""
        seconds = time.monotonic() - start
        if line:
            outcome, text, facts = json.loads(line)
            return Answer(outcome, text, seconds, facts)
        if ready:
            code = process.wait()
            answer = Answer("crash", signal.Signals(-code).name if code < 0 else f"exit status {code}", seconds, {})
        else:
            process.kill()
            answer = Answer("hang", f"no answer within {self._timeout:g} s", seconds, {})
        self.close()
        return answer

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def try_files(
    paths: list[str], command: list[str], workers: int, timeout: float, tell: Callable[[int, Answer], None]
) -> None:
    """Try all files with several processes at a time.

    Args:
        paths: The files.
        command: As in :class:`FileWorker`.
        workers: Processes at a time.
        timeout: Seconds that a file may take.
        tell: Called with the index of a file and how it ended.
    """
    todo: SimpleQueue[int | None] = SimpleQueue()
    for index in range(len(paths)):
        todo.put(index)
    for _ in range(workers):
        todo.put(None)

    def serve(_: int) -> None:
        worker = FileWorker(command, timeout)
        try:
            while (index := todo.get()) is not None:
                tell(index, worker.try_file(paths[index]))
        finally:
            worker.close()

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(serve, range(workers)))
