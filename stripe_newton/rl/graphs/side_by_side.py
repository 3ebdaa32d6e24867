# SPDX-License-Identifier: Apache-2.0
"""Two functions side by side on a GPU, as parallel branches of a graph that is recorded."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TypeVar

import torch
import warp as wp

__all__ = ["SideBySide"]

First = TypeVar("First")
Second = TypeVar("Second")


class SideBySide:
    """Runs the work of two functions beside each other, so that small kernels of one fill gaps of the other.

    Each may use what was computed before, and neither what the other one computes. It is done if the environment
    variable ``STRIPE_NEWTON_STREAMS`` is 1, on a GPU.
    """

    def __init__(self, device: str | torch.device, independent: bool = True):
        """Make the second stream.

        Args:
            device: Device of the functions' work.
            independent: Whether the functions write no common memory; otherwise they run one after the other.
        """
        wanted = independent and torch.device(device).type == "cuda" and os.environ.get("STRIPE_NEWTON_STREAMS") == "1"
        self._side = torch.cuda.Stream(device) if wanted else None

    def run(self, first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
        """Queue both; what is queued afterwards waits for both."""
        side = self._side
        if side is None:
            return first(), second()
        current = torch.cuda.current_stream(side.device)
        side.wait_stream(current)
        # `sync_enter=False`: the wait above is one that a capture may hold.
        with torch.cuda.stream(side), wp.ScopedStream(wp.stream_from_torch(side), sync_enter=False):
            of_second = second()
        of_first = first()
        current.wait_stream(side)
        return of_first, of_second
