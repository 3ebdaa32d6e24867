# SPDX-License-Identifier: Apache-2.0
"""Late stream: random numbers of a graph's first replay, where the stream of its recording has other work first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from unittest import mock

import torch

__all__ = ["LateDraw", "draw_late"]

_SLEEP = 20_000_000
"""Cycles of a kernel that does nothing, about 10 ms."""
_COUNT = 64


@dataclass(frozen=True)
class LateDraw:
    """Random numbers that a first replay has drawn, and those that it might have."""

    drawn: torch.Tensor
    expected: torch.Tensor
    """The numbers of the generator's state."""
    of_offset_0: torch.Tensor
    """The first ones of its seed."""

    @property
    def is_right(self) -> bool:
        """Whether the replay drew the numbers of the generator's state."""
        return torch.equal(self.drawn, self.expected)


def draw_late(device: str, record: Callable[[Callable[[], None], torch.cuda.Stream], Any]) -> LateDraw:
    """Record and replay a graph that draws random numbers, on a stream that is late.

    Args:
        device: A GPU.
        record: Records a function on a stream, and returns a graph to ``replay()``.
    """
    stream, drawn = torch.cuda.Stream(device), torch.zeros(_COUNT, device=device)
    wait = torch.cuda.synchronize

    def wait_then_be_busy(*args: Any) -> None:
        """Keep the stream of the recording busy after a wait, as another process does with the whole GPU."""
        wait(*args)
        with torch.cuda.stream(stream):
            torch.cuda._sleep(_SLEEP)

    def draw() -> None:
        torch.cuda._sleep(4 * _SLEEP)
        drawn.copy_(torch.randn(_COUNT, device=device))

    draw()  # torch's kernels are loaded
    torch.manual_seed(7)
    torch.rand(8, device=device)
    state = torch.cuda.get_rng_state(device)
    draw()
    expected = drawn.clone()
    torch.manual_seed(7)
    draw()
    of_offset_0 = drawn.clone()
    torch.cuda.set_rng_state(state, device)
    with mock.patch.object(torch.cuda, "synchronize", wait_then_be_busy):
        graph = record(draw, stream)
    graph.replay()
    wait()
    return LateDraw(drawn, expected, of_offset_0)
