# SPDX-License-Identifier: Apache-2.0
"""Work of torch and Warp that is recorded once as a CUDA graph and replayed."""

from __future__ import annotations

import gc
from collections.abc import Callable

import torch
import warp as wp

__all__ = ["Program"]


class Program:
    """A function on fixed memory. The first run is eager, the second records it, that and all others replay it.

    On the CPU every run is eager.
    """

    def __init__(self, function: Callable[[], None], device: str | torch.device):
        """Take a function without arguments that neither waits for the device nor depends on values on the host."""
        self._function, self._device = function, torch.device(device)
        if self._device.type == "cuda":
            wp.init()  # a function of torch alone may be the first to be recorded
            self._stream = torch.cuda.Stream(self._device)
        self._graph: torch.cuda.CUDAGraph | None = None
        self._held: wp.Graph | None = None  # what Warp must not free while the graph lives
        self._warm = False

    @property
    def recorded(self) -> bool:
        """Whether a run is a graph launch."""
        return self._graph is not None

    def forget(self) -> None:
        """Record anew at the second run from here; for whoever replaced memory that the function uses."""
        self._graph, self._warm = None, False

    def run(self) -> None:
        """Run the function."""
        if self._device.type == "cpu":
            self._function()
        elif not self._warm:
            self._run_aside()
            self._warm = True
        else:
            if self._graph is None:
                self._graph = self._record()
            self._graph.replay()

    def _run_aside(self) -> None:
        """Run on the stream that is recorded later: gradients are summed up on the stream of their first time."""
        current = torch.cuda.current_stream(self._device)
        self._stream.wait_stream(current)
        with torch.cuda.stream(self._stream), wp.ScopedStream(wp.stream_from_torch(self._stream), sync_enter=False):
            self._function()
        current.wait_stream(self._stream)

    def _record(self) -> torch.cuda.CUDAGraph:
        graph, stream = torch.cuda.CUDAGraph(), wp.stream_from_torch(self._stream)
        collecting = gc.isenabled()
        gc.collect()
        gc.disable()  # a collection may free memory of the device, which breaks the recording
        try:
            with torch.cuda.graph(graph, stream=self._stream, capture_error_mode="thread_local"):
                wp.capture_begin(stream=stream, external=True)
                with wp.ScopedStream(stream, sync_enter=False):
                    self._function()
                self._held = wp.capture_end(stream=stream)
        finally:
            if collecting:
                gc.enable()
        return graph
