# SPDX-License-Identifier: Apache-2.0
"""Entries of the name tables: what a name of Isaac Lab stands for.

An entry is a string: ``"module:attribute"``, ``"module:"`` for a module, ``"inert reason"`` for what has no effect
here, ``"refused reason"`` for what is not supported.
"""

from __future__ import annotations

__all__ = ["Table", "dialect", "inert", "refused", "same"]

Table = dict[str, str]
"""Entry by name."""


def same(module: str, names: str) -> Table:
    """Names that stand for those of a module of stripe_newton.

    Args:
        module: Such as ``"stripe_newton.assets"``.
        names: Separated by blanks; ``name=other`` where the module calls it otherwise.
    """
    pairs = (name.partition("=") for name in names.split())
    return {name: f"{module}:{other or name}" for name, _, other in pairs}


def dialect(module: str, names: str) -> Table:
    """Names that a module below ``stripe_newton.isaaclab`` translates."""
    return same(f"stripe_newton.isaaclab.{module}", names)


def inert(reason: str, names: str) -> Table:
    """Names that load, take any argument and do nothing."""
    return dict.fromkeys(names.split(), f"inert {reason}")


def refused(reason: str, names: str) -> Table:
    """Names that load, and make a config that uses them invalid."""
    return dict.fromkeys(names.split(), f"refused {reason}")
