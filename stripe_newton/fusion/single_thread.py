# SPDX-License-Identifier: Apache-2.0
"""Single thread: a generated kernel that one thread runs for all environments.

The curriculum uses it, for parameters that all environments share. ``env`` is 0 in it:

>>> import warp as wp
>>> from stripe_newton.fusion import Scope, code, single_thread
>>> scope = Scope()
>>> level = scope.name("level", wp.zeros(1, dtype=float, device="cpu"))
>>> single_thread(scope, "cpu", "curriculum", [code("{}[0] += 1.0", level)]).name
'curriculum'
"""

from __future__ import annotations

from collections.abc import Sequence

from .field_use import fields_used
from .fused_kernel import FusedKernel, fuse
from .scope import Scope
from .section import Section
from .source import Code
from .stage import KernelLaunches

__all__ = ["single_thread"]


def single_thread(
    scope: Scope, device: str, name: str, body: Sequence[Code], terms: Sequence[str] = ()
) -> KernelLaunches:
    """A generated kernel of one thread, as an item of a step.

    Args:
        scope: Arrays, structs and functions by the names that the body uses.
        device: Device of the kernel.
        name: Name of the kernel.
        body: Lines as in a :class:`Section`; ``env`` is 0.
        terms: Names of the terms in it.
    """
    section = Section(f"{name}_body", body)
    made: list[FusedKernel] = []

    def launch() -> None:
        if not made:  # compiled at the first launch, which a config with problems never reaches
            made.append(fuse(name, [section], scope, 1, device))
        made[0].launch()

    return KernelLaunches(name, launch, terms, fields=fields_used(section, scope.functions))
