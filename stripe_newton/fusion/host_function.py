# SPDX-License-Identifier: Apache-2.0
"""Host function: a part of a step that runs in Python, such as a torch hook, and may become a part of a graph.

A host function divides a step: the kernels before it are one graph, those after it another. If it has a
:class:`GraphPart` that may be recorded, its launches join these graphs, and the step is one graph again::

    kernels | torch hook | kernels            three launches in a step
    kernels + launches of the hook + kernels  one launch in a step
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

__all__ = ["ChoicePart", "GraphPart", "HostFunction"]


class GraphPart(Protocol):
    """Host function that may also be recorded in a graph, with what the host does after each replay."""

    @property
    def is_capturable(self) -> bool:
        """Whether it may be recorded now."""
        ...

    @property
    def status(self) -> str:
        """How it runs, for the description; empty for an ordinary host function."""
        ...

    def launch(self) -> Sequence[Callable[[], None]]:
        """Launch it within a recording, which runs nothing; returns what the host does after each replay."""
        ...


@runtime_checkable
class ChoicePart(GraphPart, Protocol):
    """Host function with launches that differ from step to step, of which each form may be recorded.

    A graph that begins with one form also holds what follows, so that the host launches one graph rather than two
    once it knows the form.
    """

    def choose(self) -> tuple[Hashable, object] | None:
        """Choose the form of this step, right before it runs. The host may wait for the device.

        Returns:
            Name of the form that :meth:`launch` launches now, and an object that stands for its recordings: they hold
            as long as it is the same one. None if the function must run.
        """
        ...


@dataclass(frozen=True)
class HostFunction:
    """A function that runs on the host in every step, between two graphs. It may read and write anything."""

    name: str
    """Name, for the description."""
    function: Callable[[], None]
    """Runs it."""
    reason: str
    """Reason why it cannot be captured, for the description."""
    terms: Sequence[str] = ()
    """Names of the terms that it runs, for the description."""
    part: GraphPart | None = None
    """The same as a part of a graph, where it may be one in some steps."""
