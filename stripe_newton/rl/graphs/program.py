# SPDX-License-Identifier: Apache-2.0
"""Program: a function of torch and Warp that is recorded once as a CUDA graph and then replayed."""

from __future__ import annotations

from collections.abc import Callable

import torch
import warp as wp

from stripe_newton.sim.capture import TorchGraph

__all__ = ["Program"]


class Program:
    """A function on fixed memory. Its first run is eager, the second records a CUDA graph, all later ones replay it.

    On the CPU every run is eager.
    """

    def __init__(self, function: Callable[[], None], device: str | torch.device):
        """Prepare a function; nothing runs yet.

        Args:
            function: Reads and writes the same memory in every run. It must not synchronise the host with the device
                and must not branch on values that the host reads.
            device: Device of that memory.
        """
        self._function, self._device = function, torch.device(device)
        if self._device.type == "cuda":
            wp.init()  # `wp.stream_from_torch` needs it, and the function may call torch alone
            self._stream = torch.cuda.Stream(self._device)
        self._graph: TorchGraph | None = None
        self._ran_once = False

    @property
    def recorded(self) -> bool:
        """Whether a run is a graph launch."""
        return self._graph is not None

    def invalidate(self) -> None:
        """Drop the graph: the next run is eager, the one after it records again.

        Call this after replacing an array that the function uses. A graph holds addresses, not arrays, and would go on
        with the old memory.
        """
        self._graph, self._ran_once = None, False

    def run(self) -> None:
        """Run the function."""
        if self._device.type == "cpu":
            self._function()
        elif not self._ran_once:
            # Eager first, for what happens once and must not be a part of the graph: kernels are loaded, workspaces of
            # cuBLAS are allocated, and the optimiser makes its state, which a graph would set to 0 in each replay.
            self._run_eagerly()
            self._ran_once = True
        else:
            # Recording does not execute anything, so the run that records replays as well.
            if self._graph is None:
                self._graph = TorchGraph(self._function, self._stream)
            self._graph.replay()

    def _run_eagerly(self) -> None:
        """Run the function on the stream that is recorded later.

        Autograd accumulates a gradient on the stream on which it did so first. On any other stream than the recorded
        one it would wait for work outside the capture, which makes the capture invalid.
        """
        current = torch.cuda.current_stream(self._device)
        self._stream.wait_stream(current)
        with torch.cuda.stream(self._stream), wp.ScopedStream(wp.stream_from_torch(self._stream), sync_enter=False):
            self._function()
        current.wait_stream(self._stream)
