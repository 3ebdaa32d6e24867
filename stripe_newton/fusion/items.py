# SPDX-License-Identifier: Apache-2.0
"""What a step is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

__all__ = ["Captured", "Eager", "Item", "Section"]


@dataclass
class Section:
    """Source of a Warp function of one environment. Neighbouring sections become one kernel.

    The body sees ``env`` and every name that the scope handed out; its local names are its own.
    """

    name: str
    """Name of the function in the generated source."""
    body: Sequence[str]
    """Lines of Warp's Python, without indent and without ``return``."""
    terms: Sequence[str] = ()
    """Terms that are in it, for the description."""
    where_reset: bool = False
    """Whether it runs only in the environments whose episode just ended."""
    condition: str = ""
    """Expression under which it runs at all; empty for always."""
    parts: int = 0
    """Threads that share an environment, which the body knows as ``part``; 0 for one thread. Parts may not depend on
    each other, nor on other sections of their stage that have parts."""
    neighbours: bool = False
    """Whether neighbouring threads are parts of one environment rather than environments of one part: for many parts
    that do the same with neighbouring numbers, which a GPU then reads and writes at once."""


@dataclass
class Captured:
    """A function that launches kernels and does nothing else; it becomes part of the graph as it is."""

    name: str
    function: Callable[[], None]
    terms: Sequence[str] = ()
    beside: bool = False
    """Whether what follows in the same graph does not wait for it."""


@dataclass
class Eager:
    """A function that runs on the host in every step, between two graphs."""

    name: str
    function: Callable[[], None]
    reason: str
    """Why it cannot be captured."""
    terms: Sequence[str] = field(default=())


Item = Section | Captured | Eager
