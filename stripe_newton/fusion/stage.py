# SPDX-License-Identifier: Apache-2.0
"""Stage: a named part of a step, made of three kinds of items: sections, kernel launches and host functions.

=======================  ========================================  ================================
item                     what it holds                             what becomes of it
=======================  ========================================  ================================
:class:`Section`         source code that computes an environment  a function in a fused kernel
:class:`KernelLaunches`  a function that launches kernels          a part of a graph, as it is
:class:`HostFunction`    any function, such as a torch hook        runs in Python between two graphs
=======================  ========================================  ================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from .host_function import HostFunction
from .section import Flag, Section

__all__ = ["Item", "KernelLaunches", "Stage", "only"]


@dataclass(frozen=True)
class KernelLaunches:
    """A function that launches kernels and does nothing else, so that it can be recorded in a graph."""

    name: str
    function: Callable[[], None]
    terms: Sequence[str] = ()
    concurrent: bool = False
    """Later items of the same graph may run at the same time, as none of them uses its results."""
    fields: frozenset[str] | None = None
    """Fields of structs that its kernels read or write; None if unknown, so that it may be any field."""


Item = Section | KernelLaunches | HostFunction


@dataclass(frozen=True)
class Stage:
    """A named part of a step."""

    name: str
    items: Sequence[Item]


def only(items: Iterable[Item], *flags: Flag) -> list[Item]:
    """The items with more flags on their sections. Launches and host functions always run."""
    return [item.only(*flags) if isinstance(item, Section) else item for item in items]
