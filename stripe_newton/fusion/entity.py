# SPDX-License-Identifier: Apache-2.0
"""Which asset a term is about, and which of its joints and bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stripe_newton.configclass import configclass
from stripe_newton.matching import match_names

__all__ = ["SceneEntityCfg"]


@configclass
class SceneEntityCfg:
    """An asset of the scene by name; joints and bodies by expression or index, all of them by default."""

    name: str = "robot"
    """Name in the scene."""
    joint_names: str | Sequence[str] | None = None
    """Expressions for joints."""
    joint_ids: Sequence[int] | None = None
    """Joints by index, instead of ``joint_names``."""
    body_names: str | Sequence[str] | None = None
    """Expressions for bodies."""
    body_ids: Sequence[int] | None = None
    """Bodies by index, instead of ``body_names``."""
    preserve_order: bool = False
    """Order of the expressions rather than of the asset."""

    def indices(self, kind: str, names: Sequence[str]) -> list[int]:
        """Indices of the joints (``kind="joint"``) or bodies (``"body"``) meant.

        Raises:
            ValueError: if an expression matches nothing, or an index is out of range.
        """
        expressions: Any = getattr(self, f"{kind}_names")
        given: Any = getattr(self, f"{kind}_ids")
        if expressions is not None:
            return match_names(expressions, names, self.preserve_order, f"{kind} of '{self.name}'")[0]
        if given is None or isinstance(given, slice):
            return list(range(len(names)))[given or slice(None)]
        wrong = [i for i in given if not 0 <= i < len(names)]
        if wrong:
            raise ValueError(f"{kind}_ids: {wrong} of '{self.name}', which has {len(names)}")
        return [int(i) for i in given]
