# SPDX-License-Identifier: Apache-2.0
"""Term call: a Warp function with the source code of its arguments.

>>> from stripe_newton.fusion import Code, TermCall
>>> call = TermCall(Code("joint_pos"), {"env": Code("env"), "robot": Code("robot"), "out": OUT})
>>> call.expression(out=Code("obs_policy[env]"), sliced=["out"], span="0:12").text
'joint_pos(env, robot, obs_policy[env][0:12])'
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from .source import Code, ParameterRead, code

__all__ = ["OUT", "TermCall"]

OUT = Code("{out}")
"""Placeholder of the array that an observation writes, which :meth:`TermCall.expression` replaces."""


@dataclass(frozen=True)
class TermCall:
    """The call of a term, whose arguments have been found."""

    function: Code
    """Name of the function in the source code."""
    arguments: Mapping[str, Code]
    """Source code of each argument, in order; :data:`OUT` for the array that an observation writes."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """Lengths of index arrays by argument, and ``num_actions``, ``num_command``, ``num_objects`` where they apply."""

    def expression(self, out: Code | None = None, sliced: Sequence[str] = (), span: str = "") -> Code:
        """Source code of the call.

        Args:
            out: Array that an observation writes.
            sliced: Arguments of which only a slice is passed.
            span: The slice, as ``first:last``.
        """
        given = []
        for name, argument in self.arguments.items():
            argument = out if argument is OUT and out is not None else argument
            given.append(code("{}[{}]", argument, span) if name in sliced else argument)
        return code(f"{{}}({', '.join(['{}'] * len(given))})", self.function, *given)

    def differing_parameters(self, other: TermCall) -> list[tuple[Code, Code]] | None:
        """Pairs of parameters in which two calls differ; None if they differ in anything else."""
        if self.function != other.function or self.arguments.keys() != other.arguments.keys():
            return None
        pairs = [(own, other.arguments[name]) for name, own in self.arguments.items()]
        differing = [(own, its) for own, its in pairs if own != its]
        are_parameters = all(isinstance(argument, ParameterRead) for pair in differing for argument in pair)
        return differing if are_parameters else None
