# SPDX-License-Identifier: Apache-2.0
"""Graph capture: records launches as a CUDA graph, those of Warp alone or those of torch and Warp together."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterable, Iterator

import torch
import warp as wp

__all__ = ["TorchGraph", "capture_graph"]


def capture_graph(device: str, function: Callable[[], None]) -> wp.Graph:
    """Record what ``function`` launches with Warp; nothing of it runs now.

    Raises:
        Exception: what CUDA or the function raises if it does something that cannot be recorded.
    """
    with _no_collection(), wp.ScopedCapture(device=device) as capture:
        function()
    return capture.graph


class TorchGraph:
    """A CUDA graph of what a function launches with torch and with Warp, on memory that stays where it is.

    Recording runs nothing. Torch's default generator advances in each replay as it would in the function.
    """

    def __init__(
        self,
        function: Callable[[], None],
        stream: torch.cuda.Stream,
        pool: tuple[int, int] | None = None,
        generators: Iterable[torch.Generator] = (),
        free_memory: bool = True,
    ):
        """Record.

        Args:
            function: Launches work; it must neither wait for the device nor copy from the host.
            stream: Stream to record on, other than the default one.
            pool: Memory pool that several graphs share, of ``torch.cuda.graph_pool_handle()``. Such graphs must not
                replay at the same time, nor expect temporary tensors of each other.
            generators: Generators other than torch's default that the function draws from.
            free_memory: Whether memory that torch holds in reserve is given back first, for graphs that need much. It
                takes long, and so does allocating it again.

        Raises:
            Exception: what CUDA or the function raises if it does something that cannot be recorded. Torch can then
                record and draw random numbers as before, but not record into this pool.
        """
        wp.init()  # a function that calls torch alone may be the first to be recorded
        self._graph = torch.cuda.CUDAGraph()
        for generator in generators:
            self._graph.register_generator_state(generator)
        on_warp = wp.stream_from_torch(stream)
        recording = _capture(self._graph, stream, pool, free_memory)
        failed: Exception | None = None
        try:
            with _no_collection(), recording:
                # torch owns the capture (`external=True`), Warp only has to know of it: it must neither synchronise
                # nor free what it launches from here on. `sync_enter=False`: waiting for the stream used before would
                # record an event of a stream outside the capture.
                wp.capture_begin(stream=on_warp, external=True)
                try:
                    with wp.ScopedStream(on_warp, sync_enter=False):
                        function()
                except Exception as error:  # kept until the capture has ended in both libraries
                    failed = error
                # Warp's own record of the capture. It keeps modules and arrays alive that the graph uses.
                self._warp_graph = wp.capture_end(stream=on_warp)
        except Exception as error:
            _recover(stream, pool)
            # What the function raised says more than that the capture it spoiled could not be ended.
            raise (failed or error) from (error if failed else None)
        if failed is not None:
            raise failed
        # Before a capture torch (up to 2.12) sets seed and offset of its random numbers on the stream of the capture,
        # in memory that all graphs share. A replay sets them on its own stream, which need not wait for that one. On a
        # GPU that is busy with something else, the first replay could draw the numbers of offset 0.
        stream.synchronize()

    def replay(self) -> None:
        """Launch the graph on torch's current stream."""
        self._graph.replay()


@contextlib.contextmanager
def _capture(
    graph: torch.cuda.CUDAGraph, stream: torch.cuda.Stream, pool: tuple[int, int] | None, free_memory: bool
) -> Iterator[None]:
    """Capture as ``torch.cuda.graph`` does, but for its collection of garbage, which takes a tenth of a second."""
    torch.cuda.synchronize(stream.device)
    if free_memory:
        torch.cuda.empty_cache()
    with torch.cuda.stream(stream):
        # "thread_local": other threads, such as the one that writes a video, may go on calling CUDA meanwhile.
        # The type of a pool differs between versions of torch.
        graph.capture_begin(pool=pool, capture_error_mode="thread_local")  # type: ignore[arg-type]
        try:
            yield
        finally:
            graph.capture_end()


def _recover(stream: torch.cuda.Stream, pool: tuple[int, int] | None) -> None:
    """Bring torch to order after a capture that could not be ended.

    Torch (up to 2.12) then goes on as if it were recording: to draw a random number is an error, and its allocator
    keeps freed memory.
    """
    end = getattr(torch._C, "_cuda_endAllocateToPool", None)
    if pool is not None and end is not None:
        with contextlib.suppress(RuntimeError):  # it has been ended
            end(stream.device.index, pool)
    # The end of a recording that succeeds also ends that of the random generator.
    graph, own = torch.cuda.CUDAGraph(), torch.cuda.Stream(stream.device)
    with contextlib.suppress(RuntimeError), torch.cuda.device(stream.device), _capture(graph, own, None, False):
        torch.zeros(1, device=stream.device)


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """Keep Python's garbage collector off: it may free device memory or destroy events, which breaks a capture."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
