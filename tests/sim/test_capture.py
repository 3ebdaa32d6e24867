# SPDX-License-Identifier: Apache-2.0
"""Graphs of torch and Warp together: random numbers of the first replay, pools, and recordings that fail.

Without a GPU a stand-in for torch's graphs has its streams: what is launched on one runs when somebody waits for it,
or at the worst moment.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import torch
import warp as wp

from stripe_newton.envs.hook_parts import Recorder
from stripe_newton.sim import capture
from stripe_newton.sim.capture import TorchGraph
from tests.helpers.late_stream import draw_late

DEVICE = "cuda:0"


class FakeStream:
    """A stream whose work waits until it is asked for."""

    def __init__(self, device: Any = None):
        self.device = SimpleNamespace(type="cuda", index=0)
        self.waiting: list[Callable[[], None]] = []

    def synchronize(self) -> None:
        while self.waiting:
            self.waiting.pop(0)()


class FakeTorch:
    """Streams, graphs and pools of a torch that shares the offset of random numbers between graphs, as 2.11 does."""

    def __init__(self) -> None:
        self.current = self.default = FakeStream()
        self.streams = [self.default]
        self.offset_on_device, self.offset, self.records = -1, 12, False
        self.drawn: list[int] = []
        self.alive: dict[int, int] = {}
        self.pools = 0

    def synchronize(self, device: Any = None) -> None:
        for stream in self.streams:
            stream.synchronize()

    @contextlib.contextmanager
    def stream(self, stream: FakeStream) -> Any:
        before, self.current = self.current, stream
        if stream not in self.streams:
            self.streams.append(stream)
        yield
        self.current = before

    def set_offset(self, value: int) -> None:
        self.current.waiting.append(lambda: setattr(self, "offset_on_device", value))

    def draw(self) -> None:
        """A kernel that draws a random number: the worst order of streams is one in which all others run first."""
        if self.records:
            return
        for stream in self.streams:
            if stream is not self.current:
                stream.synchronize()
        self.drawn.append(self.offset_on_device)

    def graph_pool_handle(self) -> tuple[int, int]:
        self.pools += 1
        return 0, self.pools


class FakeGraph:
    """A graph that draws one random number, in a pool that lives as long as a graph in it does."""

    torch: FakeTorch

    def __init__(self) -> None:
        self._pool: int | None = None

    def capture_begin(self, pool: tuple[int, int] | None, capture_error_mode: str) -> None:
        if pool is not None:
            alive = self.torch.alive
            if alive.get(pool[1]) == 0:
                raise RuntimeError("use_count > 0 INTERNAL ASSERT FAILED")
            alive[pool[1]] = alive.get(pool[1], 0) + 1
            self._pool = pool[1]
        self.torch.set_offset(0)
        self.torch.records = True

    def capture_end(self) -> None:
        self.torch.records = False

    def replay(self) -> None:
        self.torch.set_offset(self.torch.offset)
        self.torch.current.waiting.append(self.torch.draw)
        self.torch.offset += 4

    def __del__(self) -> None:
        if self._pool is not None:
            self.torch.alive[self._pool] -= 1


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeTorch:
    found = FakeTorch()
    graph = type("Graph", (FakeGraph,), {"torch": found})
    for name, value in {
        "CUDAGraph": graph, "Stream": FakeStream, "stream": found.stream, "synchronize": found.synchronize,
        "graph_pool_handle": found.graph_pool_handle, "device": contextlib.nullcontext,
    }.items():  # fmt: skip
        monkeypatch.setattr(torch.cuda, name, value)
    monkeypatch.setattr(wp, "stream_from_torch", lambda stream: stream)
    monkeypatch.setattr(wp, "ScopedStream", lambda stream, sync_enter: contextlib.nullcontext())
    monkeypatch.setattr(wp, "capture_begin", lambda stream, external: None)
    monkeypatch.setattr(wp, "capture_end", lambda stream: object())
    return found


def test_the_first_replay_draws_the_numbers_of_its_offset_however_late_the_recording_stream_is(fake):
    graph = TorchGraph(fake.draw, FakeStream(), free_memory=False)
    for _ in range(2):
        graph.replay()
    fake.default.synchronize()
    assert fake.drawn == [12, 16]


def test_a_pool_is_not_used_again_when_its_last_graph_is_gone(fake):
    record = Recorder(SimpleNamespace(device=DEVICE))
    first, second = record(fake.draw), record(fake.draw)
    assert fake.pools == 1
    del first, second
    assert record(fake.draw) is not None  # as when all hooks of an environment are recorded anew
    assert fake.pools == 2


def fail() -> None:
    raise ValueError("it cannot be recorded")


def test_a_recording_that_failed_leaves_its_pool_to_the_graphs_in_it(fake):
    record = Recorder(SimpleNamespace(device=DEVICE))
    kept = record(fake.draw)
    with pytest.raises(ValueError, match="it cannot be recorded"):
        record(fail)
    assert record(fake.draw) is not None
    assert (kept is not None, fake.pools) == (True, 2)


def test_after_a_capture_that_cannot_be_ended_an_empty_one_ends_that_of_the_random_generator(fake, monkeypatch):
    ended: list[object] = []
    end = torch.cuda.CUDAGraph.capture_end

    def capture_end(self: FakeGraph) -> None:
        if not ended:
            ended.append(self)
            raise RuntimeError("operation failed due to a previous error during capture")
        end(self)

    monkeypatch.setattr(torch.cuda.CUDAGraph, "capture_end", capture_end)
    monkeypatch.setattr(capture.torch, "zeros", lambda *a, **k: None)
    with pytest.raises(ValueError, match="it cannot be recorded"):
        TorchGraph(fail, FakeStream(), free_memory=False)
    assert not fake.records


# -- on a GPU


@pytest.mark.gpu
def test_first_replay_on_a_gpu_whose_recording_stream_is_late():
    assert draw_late(DEVICE, lambda draw, stream: TorchGraph(draw, stream, free_memory=False)).is_right


@pytest.mark.gpu
def test_random_numbers_and_recordings_go_on_after_a_capture_that_failed():
    def waits() -> None:
        torch.randn(4, device=DEVICE)
        torch.cuda.synchronize()  # spoils a capture, and no watch of torch sees it

    record = Recorder(SimpleNamespace(device=DEVICE))
    drawn = torch.zeros(4, device=DEVICE)
    kept = record(lambda: drawn.copy_(torch.rand(4, device=DEVICE)))
    for _ in range(2):
        with pytest.raises(RuntimeError):
            record(waits)
    assert torch.isfinite(torch.rand(4, device=DEVICE)).all()
    kept.replay()
    del kept
    record(lambda: drawn.copy_(torch.rand(4, device=DEVICE))).replay()
    torch.manual_seed(3)
    assert torch.isfinite(drawn).all()
