# SPDX-License-Identifier: Apache-2.0
"""Segment launcher: launches the operations of segments in order, and concurrent ones on streams of their own.

Used while a CUDA graph is recorded. A concurrent operation becomes a branch of the graph, which joins at the end::

    rewards ── reset ── observations ── end
       └────── recorder (concurrent) ────┘
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from .segments import Operation, Segment

__all__ = ["SegmentLauncher"]


class SegmentLauncher:
    """Launches segments on the current stream of a device."""

    def __init__(self, device: str):
        self._device = device
        self._side_streams: list[wp.Stream] = []

    def launch(self, segments: Sequence[Segment]) -> list[Callable[[], None]]:
        """Launch segments, of which each host function must be capturable.

        Returns:
            What the host does after each replay of a graph that was recorded from this.
        """
        after: list[Callable[[], None]] = []
        for segment in segments:
            if segment.host is not None and segment.host.part is not None:
                after += segment.host.part.launch()
            self._launch_operations(segment.operations)
        return after

    def _launch_operations(self, operations: Sequence[Operation]) -> None:
        streams = list[wp.Stream]()
        for operation in operations:
            if operation.concurrent and self._device != "cpu":
                streams.append(self._side_stream(len(streams)))
                with wp.ScopedStream(streams[-1], sync_enter=True):
                    operation.launch()
            else:
                operation.launch()
        for stream in streams:  # all streams of a capture must join the one on which it began before it ends
            wp.get_stream(self._device).wait_stream(stream)

    def _side_stream(self, index: int) -> wp.Stream:
        """Stream of a concurrent operation; streams are made once and used again."""
        while len(self._side_streams) <= index:
            self._side_streams.append(wp.Stream(self._device))
        return self._side_streams[index]
