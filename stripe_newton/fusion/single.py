# SPDX-License-Identifier: Apache-2.0
"""Work that one thread does for all environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .items import Captured, Section
from .kernels import FusedKernel, fuse

__all__ = ["single_thread"]


def single_thread(context: Any, name: str, body: Sequence[str], terms: Sequence[str] = ()) -> Captured:
    """A generated kernel of one thread, as an item of a step.

    Args:
        context: The manager context.
        name: Name of the kernel.
        body: Lines as of a :class:`Section`; ``env`` is 0.
        terms: Terms that are in it.
    """
    made: list[FusedKernel] = []

    def launch() -> None:
        if not made:
            made.append(fuse(name, [Section(f"{name}_body", body)], context.scope, 1, context.device))
        made[0].launch()

    return Captured(name, launch, terms)
