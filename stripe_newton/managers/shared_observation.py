# SPDX-License-Identifier: Apache-2.0
"""Shared observation: a wide term that several groups have in common, computed once.

Policy and critic often observe the same height scan, which takes longer than all other terms together.
"""

from __future__ import annotations

from stripe_newton.fusion import Code, Section, block, code

from .observation_source import ObservationSource
from .observation_term import ObservationTerm

__all__ = ["SharedObservation"]


class SharedObservation:
    """A term with a thread for each part, and the terms of other groups that compute the same values.

    These copy its values before noise, clip and scale, which differ from term to term. They compute the values
    themselves while one of their parameters has another value.
    """

    def __init__(self, group: str, name: str, term: ObservationTerm, source: ObservationSource):
        self._title, self._terms = f"observations_{group}_{name}", [name]
        self._term, self._parts = term, source.parts
        self._call, self._process = source.part()
        self._copies: list[Code] = []

    def add(self, name: str, term: ObservationTerm, source: ObservationSource) -> bool:
        """Add a term of another group if it computes the same values. Returns whether it does."""
        assert term.call is not None
        assert self._term.call is not None
        differing = self._term.call.differing_parameters(term.call)
        if differing is None or source.parts != self._parts or term.size != self._term.size:
            return False
        call, process = source.part()
        size = term.size // self._parts
        self._copies += block(
            code("for i in range(k * {}, (k + 1) * {}):", size, size),
            [code("{} = {}", term.element, self._term.element)],
        )
        if differing:  # parameters that are equal now may be changed later
            differs = code(
                " or ".join(["{} != {}"] * len(differing)), *(number for pair in differing for number in pair)
            )
            self._copies += block(code("if {}:", differs), [call])
        self._process += process
        self._terms.append(name)
        return True

    def section(self) -> Section:
        """The section of all these terms. Parts are consecutive threads, as neighbouring rays read nearby memory."""
        body = [code("k = part"), self._call, *self._copies, *self._process]
        return Section(self._title, body, self._terms, parts=self._parts, coalesced=True)
