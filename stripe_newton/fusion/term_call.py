# SPDX-License-Identifier: Apache-2.0
"""Term call: a Warp function with the source of its arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from .source import Code, TunedNumber, code

__all__ = ["OUT", "TermCall"]

OUT = Code("{out}")
"""Stands for the place where an observation is written, which :meth:`TermCall.expression` is told."""


@dataclass(frozen=True)
class TermCall:
    """A term with its arguments found."""

    function: Code
    """Name of the function in the source."""
    arguments: Mapping[str, Code]
    """Source of each argument, in order; :data:`OUT` for the place where an observation is written."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """Lengths of index arrays by argument, and ``num_actions``, ``num_command``, ``num_objects`` where they apply."""

    def expression(self, out: Code | None = None, sliced: Sequence[str] = (), span: str = "") -> Code:
        """Source of the call.

        Args:
            out: Where an observation is written.
            sliced: Arguments of which only a part is passed.
            span: That part, as ``first:last``.
        """
        given = []
        for name, argument in self.arguments.items():
            argument = out if argument is OUT and out is not None else argument
            given.append(code("{}[{}]", argument, span) if name in sliced else argument)
        return code(f"{{}}({', '.join(['{}'] * len(given))})", self.function, *given)

    def tuned_apart(self, other: TermCall) -> list[tuple[Code, Code]] | None:
        """Pairs of tuned numbers in which two calls differ; None if they differ in anything else."""
        if self.function != other.function or self.arguments.keys() != other.arguments.keys():
            return None
        apart = [(mine, other.arguments[name]) for name, mine in self.arguments.items()]
        apart = [(mine, its) for mine, its in apart if mine != its]
        tuned = all(isinstance(number, TunedNumber) for pair in apart for number in pair)
        return apart if tuned else None
