# SPDX-License-Identifier: Apache-2.0
"""Graph capture: records launches as a CUDA graph."""

from __future__ import annotations

import gc
from collections.abc import Callable

import warp as wp

__all__ = ["capture_graph"]


def capture_graph(device: str, function: Callable[[], None]) -> wp.Graph:
    """Record what ``function`` launches; nothing of it runs now.

    Raises:
        Exception: what CUDA or the function raises if it does something that cannot be recorded.
    """
    collecting = gc.isenabled()
    gc.disable()  # a collection during capture may free device memory, which breaks the capture
    try:
        with wp.ScopedCapture(device=device) as capture:
            function()
    finally:
        if collecting:
            gc.enable()
    return capture.graph
