# SPDX-License-Identifier: Apache-2.0
"""Stage: a named part of a step, made of three kinds of items: sections of source code, launches and host functions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import warp as wp

from .source import Code
from .usage import usage_of

__all__ = [
    "Captured",
    "ChoicePart",
    "Eager",
    "Flag",
    "GraphPart",
    "Item",
    "Section",
    "Stage",
    "fields_used",
    "may_use",
    "only",
]


@dataclass(frozen=True, order=True)
class Flag:
    """A condition of one environment, such as that its episode just ended."""

    rank: int
    """Order among several flags; lower ranks are tested first."""
    code: Code = dataclasses.field(compare=False)
    """The expression."""


@dataclass(frozen=True)
class Section:
    """Source code of a Warp function that computes one environment. Neighbouring sections become one kernel.

    The body can use ``env`` and the names in its pieces of code. Its local variables are not visible to other sections.
    """

    name: str
    """Name of the function in the generated source code."""
    body: Sequence[Code]
    """Lines in Warp's subset of Python, not indented and without ``return``."""
    terms: Sequence[str] = ()
    """Names of the terms in it, for the description."""
    when: frozenset[Flag] = frozenset()
    """Flags that must all be set for it to run."""
    parts: int = 0
    """Number of threads for each environment; the body uses their index, ``part``. 0 for one thread. Parts must not
    depend on each other, nor on other sections with parts in the same stage."""
    coalesced: bool = False
    """Whether consecutive threads are parts of one environment rather than environments: for many parts that do the
    same with consecutive numbers, so that a GPU combines their memory accesses."""

    @property
    def uses_in_body(self) -> frozenset[str]:
        """Names of the arrays, structs and functions in the body."""
        return frozenset().union(*(line.uses for line in self.body))

    @property
    def uses(self) -> frozenset[str]:
        """Names of the arrays, structs and functions in the body and in the flags."""
        return self.uses_in_body.union(*(flag.code.uses for flag in self.when))

    def only(self, *flags: Flag) -> Section:
        """This section under more flags: it runs only where these are set too."""
        return dataclasses.replace(self, when=self.when | set(flags))

    def joined(self, other: Section) -> Section:
        """This section followed by another, as one section with the flags of this one."""
        return dataclasses.replace(self, body=[*self.body, *other.body], terms=[*self.terms, *other.terms])


@dataclass(frozen=True)
class Captured:
    """A function that launches kernels and does nothing else, so that it can be recorded in a graph."""

    name: str
    function: Callable[[], None]
    terms: Sequence[str] = ()
    concurrent: bool = False
    """Later items of the same graph may run at the same time, as none of them uses its results."""
    fields: frozenset[str] | None = None
    """Fields of structs that its kernels read or write; None if unknown, so that it may be any field."""


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
class Eager:
    """A function that runs on the host in every step, between two graphs. It may read and write anything."""

    name: str
    function: Callable[[], None]
    reason: str
    """Reason why it cannot be captured, for the description."""
    terms: Sequence[str] = ()
    part: GraphPart | None = None
    """The same as a part of a graph, where it may be one in some steps."""


Item = Section | Captured | Eager


@dataclass(frozen=True)
class Stage:
    """A named part of a step."""

    name: str
    items: Sequence[Item]


def only(items: Iterable[Item], *flags: Flag) -> list[Item]:
    """The items with more flags on their sections. Launches and host functions always run."""
    return [item.only(*flags) if isinstance(item, Section) else item for item in items]


def fields_used(section: Section, functions: Mapping[str, wp.Function]) -> frozenset[str] | None:
    """Fields of structs that a section reads or writes, itself or in functions that it calls; None if unknown.

    Args:
        section: The section.
        functions: Warp functions by the names that sections call them by.
    """
    called = [usage_of(functions[name]) for name in section.uses if name in functions]
    if any(usage.unresolved for usage in called):
        return None
    own = {name.partition(".")[2] for name in section.uses if "." in name}
    return frozenset(own).union(*(usage.reads | usage.writes for usage in called))


def may_use(item: Item, fields: Set[str], functions: Mapping[str, wp.Function]) -> bool:
    """Whether an item may read or write one of some fields of structs. True if that is unknown.

    Args:
        item: The item.
        fields: Names of the fields.
        functions: Warp functions by the names that sections call them by.
    """
    if isinstance(item, Eager):
        return True
    used = item.fields if isinstance(item, Captured) else fields_used(item, functions)
    return used is None or not used.isdisjoint(fields)
