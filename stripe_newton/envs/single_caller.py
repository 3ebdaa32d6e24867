# SPDX-License-Identifier: Apache-2.0
"""Single caller: one step of an environment at a time, refusing those of other threads and of its own hooks."""

from __future__ import annotations

import threading

__all__ = ["SingleCaller"]


class SingleCaller:
    """Context of a step. Two threads that step one environment would mix their launches, and nothing would tell.

    Args:
        owner: Name of the environment, for the message.
    """

    def __init__(self, owner: str):
        self._owner = owner
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(
                f"{self._owner}: step() was called within a step; call it from one thread at a time, and not from hooks"
            )

    def __exit__(self, *error: object) -> None:
        self._lock.release()
