# SPDX-License-Identifier: Apache-2.0
"""Section: lines of generated source code that compute one environment, and the flags under which they run.

A section becomes a Warp function, and its flags become the condition of the call:

>>> import warp as wp
>>> from stripe_newton.fusion import Flag, Scope, Section, code
>>> from stripe_newton.fusion.kernel_source import write_kernel
>>> scope = Scope()
>>> length = scope.name("length", wp.zeros(2, dtype=int, device="cpu"))
>>> has_ended = Flag(0, code("{}[env] > 100", length))
>>> restart = Section("restart", [code("{}[env] = 0", length)]).only(has_ended)
>>> print(write_kernel("step", [restart], scope, 2).text)
# Generated ...
@wp.func
def restart(env: int, length: wp.array[int]):
    length[env] = 0
...
    if length[env] > 100:
        restart(env, length)
<BLANKLINE>
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from .source import Code

__all__ = ["Flag", "Section"]


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
