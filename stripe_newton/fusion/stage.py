# SPDX-License-Identifier: Apache-2.0
"""Stages of a step, and the three kinds of items they consist of: sections of source, launches and host functions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass

import warp as wp

from .source import Code
from .usage import usage_of

__all__ = ["Captured", "Eager", "Flag", "Item", "Section", "Stage", "fields_used", "may_use", "only"]


@dataclass(frozen=True, order=True)
class Flag:
    """A condition of one environment, such as that its episode just ended."""

    rank: int
    """Where it stands among several; those of a lower rank are tested first."""
    code: Code = dataclasses.field(compare=False)
    """The expression."""


@dataclass(frozen=True)
class Section:
    """Source of a Warp function of one environment. Neighbouring sections become one kernel.

    The body sees ``env`` and the names in its pieces of source; its local names are its own.
    """

    name: str
    """Name of the function in the generated source."""
    body: Sequence[Code]
    """Lines of Warp's Python, without indent and without ``return``."""
    terms: Sequence[str] = ()
    """Terms that are in it, for the description."""
    when: frozenset[Flag] = frozenset()
    """Flags that must all be set for it to run."""
    parts: int = 0
    """Threads that share an environment, which the body knows as ``part``; 0 for one thread. Parts may not depend on
    each other, nor on other sections of their stage that have parts."""
    neighbours: bool = False
    """Whether neighbouring threads are parts of one environment rather than environments of one part: for many parts
    that do the same with neighbouring numbers, which a GPU then reads and writes at once."""

    @property
    def uses_in_body(self) -> frozenset[str]:
        """Names of the arrays, structs and functions in the body."""
        return frozenset().union(*(line.uses for line in self.body))

    @property
    def uses(self) -> frozenset[str]:
        """Names of the arrays, structs and functions in the body and in the flags."""
        return self.uses_in_body.union(*(flag.code.uses for flag in self.when))

    def only(self, *flags: Flag) -> Section:
        """The same section, which runs only where some more flags are set."""
        return dataclasses.replace(self, when=self.when | set(flags))

    def joined(self, other: Section) -> Section:
        """This section and then another one, as one section under the same flags."""
        return dataclasses.replace(self, body=[*self.body, *other.body], terms=[*self.terms, *other.terms])


@dataclass(frozen=True)
class Captured:
    """A function that launches kernels and does nothing else; it becomes part of the graph as it is."""

    name: str
    function: Callable[[], None]
    terms: Sequence[str] = ()
    beside: bool = False
    """Whether what follows in the same graph does not wait for it."""
    fields: frozenset[str] | None = None
    """Fields of structs that its kernels read or write; None if that is not known, so that it may be any."""


@dataclass(frozen=True)
class Eager:
    """A function that runs on the host in every step, between two graphs. It may read whatever there is."""

    name: str
    function: Callable[[], None]
    reason: str
    """Why it cannot be captured."""
    terms: Sequence[str] = ()


Item = Section | Captured | Eager


@dataclass(frozen=True)
class Stage:
    """A named part of a step."""

    name: str
    items: Sequence[Item]


def only(items: Iterable[Item], *flags: Flag) -> list[Item]:
    """The items, of which sections run only where some more flags are set. Launches and host functions always run."""
    return [item.only(*flags) if isinstance(item, Section) else item for item in items]


def fields_used(section: Section, functions: Mapping[str, wp.Function]) -> frozenset[str] | None:
    """Fields of structs that a section may read or write, itself or in functions; None if that may be any.

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
    """Whether an item may read or write one of some fields of structs.

    Args:
        item: The item.
        fields: Names of the fields.
        functions: Warp functions by the names that sections call them by.
    """
    if isinstance(item, Eager):
        return True
    used = item.fields if isinstance(item, Captured) else fields_used(item, functions)
    return used is None or not used.isdisjoint(fields)
