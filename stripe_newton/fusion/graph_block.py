# SPDX-License-Identifier: Apache-2.0
"""Graph block: consecutive segments that are one CUDA graph, or a host function alone.

A host function that may be recorded now joins the graphs before and after it. With a torch hook between two segments
of kernels, the blocks of a step are::

    hook in Python    [kernels] [hook] [kernels]    two graphs
    hook recorded     [kernels   hook   kernels]    one graph
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field

from .host_function import ChoicePart
from .segments import Segment

__all__ = ["GraphBlock", "blocks_of"]


@dataclass
class GraphBlock:
    """Consecutive segments that are one graph, or a host function alone."""

    segments: list[Segment]
    """The segments; the host function alone is one, too."""
    replay: Callable[[], None] | None = None
    """Launches the graph; None until it is recorded, and for a host function alone."""
    after: list[Callable[[], None]] = field(default_factory=list)
    """Functions that the host calls after each replay."""
    chooser: ChoicePart | None = None
    """The host function of the block, if it chooses among forms and a graph follows it."""
    following: list[Segment] = field(default_factory=list)
    """Segments of that graph. Each form is recorded together with them."""
    forms: dict[Hashable, tuple[object, GraphBlock]] = field(default_factory=dict)
    """Recorded graphs by form, each with the object that stands for its recordings, see :class:`ChoicePart`."""

    def launch(self) -> None:
        """Launch its graph, and do the host's part after it."""
        assert self.replay is not None
        self.replay()
        for function in self.after:
            function()

    @property
    def is_graph(self) -> bool:
        """Whether it may be recorded as one graph now."""
        return self.segments[0].is_capturable

    @property
    def is_mixed(self) -> bool:
        """Whether it holds the launches of host functions."""
        return self.is_graph and any(s.host is not None for s in self.segments)


def blocks_of(segments: Sequence[Segment]) -> list[GraphBlock]:
    """Group consecutive segments that may be one graph now; a host function that may not is a block alone."""
    blocks: list[GraphBlock] = []
    for segment in segments:
        if blocks and blocks[-1].is_graph and segment.is_capturable:
            blocks[-1].segments.append(segment)
        else:
            blocks.append(GraphBlock([segment]))
    return blocks
