# SPDX-License-Identifier: Apache-2.0
"""Thread layout: the environment, and the part of a section, that each thread of a generated kernel computes.

>>> from stripe_newton.fusion import Section, code
>>> from stripe_newton.fusion.thread_layout import ThreadLayout
>>> rewards = Section("rewards", [code("pass")])
>>> height_scan = Section("height_scan", [code("pass")], parts=187)
>>> ThreadLayout.of([rewards]).dim(4096), ThreadLayout.of([height_scan]).dim(4096)
((4096,), (187, 4096))
>>> ThreadLayout.of([rewards]).lines(), ThreadLayout.of([height_scan]).lines()
(['env = wp.tid()'], ['part, env = wp.tid()'])
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .section import Section

__all__ = ["ThreadLayout"]


@dataclass(frozen=True)
class ThreadLayout:
    """Thread layout of a launch: the environment, and the part of a section, that each thread computes.

    Without parts there is a thread for each environment. With parts the launch has the shape ``(parts, num_envs)``, so
    that consecutive threads are environments. In ``coalesced`` sections consecutive threads are parts of one
    environment instead; their threads come last, and the launch is then one-dimensional.
    """

    parts: int
    """Number of parts of all sections; 0 if there are none."""
    coalesced: int
    """Number of parts of coalesced sections."""

    @staticmethod
    def of(sections: Sequence[Section]) -> ThreadLayout:
        """The layout for some sections."""
        return ThreadLayout(sum(s.parts for s in sections), sum(s.parts for s in sections if s.coalesced))

    def dim(self, num_envs: int) -> tuple[int, ...]:
        """Dimensions of the launch."""
        if not self.parts:
            return (num_envs,)
        return (self.parts * num_envs,) if self.coalesced else (self.parts, num_envs)

    @property
    def block_dim(self) -> int:
        """Number of threads of a block."""
        # With a thread for each environment, blocks are small: a few thousand environments in blocks of 32 then reach
        # all multiprocessors of a large GPU.
        return 128 if self.parts else 32

    def lines(self) -> list[str]:
        """Lines that compute the environment and the part of a thread."""
        if not self.parts:
            return ["env = wp.tid()"]
        if not self.coalesced:
            return ["part, env = wp.tid()"]
        last = self.coalesced
        first = self.parts - last  # parts of the other sections
        if not first:
            return ["thread = wp.tid()", f"env = thread // {last}", f"part = thread % {last}"]
        return [
            "thread = wp.tid()",
            "part, env = thread // num_envs, thread % num_envs",
            f"if thread >= {first} * num_envs:",
            f"    env = (thread - {first} * num_envs) // {last}",
            f"    part = {first} + (thread - {first} * num_envs) % {last}",
        ]
