# SPDX-License-Identifier: Apache-2.0
"""Scene entity: an asset or a sensor in the config of a term, with some of its joints or bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from stripe_newton.configclass import configclass
from stripe_newton.matching import match_names

__all__ = ["HasNames", "SceneEntityCfg", "resolve_entities"]


@configclass
class SceneEntityCfg:
    """An asset or sensor of the scene by name, and some of its joints and bodies; by default all of them."""

    name: str = "robot"
    """Name in the scene."""
    joint_names: str | Sequence[str] | None = None
    """Expressions for joints."""
    joint_ids: Sequence[int] | slice | None = None
    """Joints by index, instead of ``joint_names``."""
    body_names: str | Sequence[str] | None = None
    """Expressions for bodies."""
    body_ids: Sequence[int] | slice | None = None
    """Bodies by index, instead of ``body_names``."""
    preserve_order: bool = False
    """Use the order of the expressions rather than that of the asset."""

    def chooses(self, kind: str) -> bool:
        """Whether it names joints (``kind="joint"``) or bodies (``"body"``), by expression or index."""
        return any(getattr(self, f"{kind}_{what}") is not None for what in ("names", "ids"))

    def indices(self, kind: str, names: Sequence[str]) -> list[int]:
        """Indices of the chosen joints (``kind="joint"``) or bodies (``"body"``) among ``names``.

        Raises:
            ValueError: if an expression matches nothing, or an index is out of range.
        """
        expressions = {"joint": self.joint_names, "body": self.body_names}[kind]
        given = {"joint": self.joint_ids, "body": self.body_ids}[kind]
        if expressions is not None:
            return match_names(expressions, names, self.preserve_order, f"{kind} of '{self.name}'")[0]
        if given is None or isinstance(given, slice):
            return list(range(len(names)))[given or slice(None)]
        wrong = [i for i in given if not 0 <= i < len(names)]
        if wrong:
            raise ValueError(f"{kind}_ids: {wrong} of '{self.name}', which has {len(names)}")
        return [int(i) for i in given]

    def resolved(self, thing: HasNames) -> SceneEntityCfg:
        """A copy with the joints and bodies that it chooses as indices, as torch terms take it.

        Args:
            thing: The asset or sensor that it names.

        Raises:
            ValueError: if an expression matches nothing.
        """
        ids = {f"{kind}_ids": (kind, thing.names_of(kind)) for kind in ("joint", "body")}
        found = {k: self.indices(kind, names) for k, (kind, names) in ids.items() if names is not None}
        return self.replace(**found)


class HasNames(Protocol):
    """An asset or sensor, of which terms choose joints or bodies."""

    def names_of(self, kind: str) -> list[str] | None:
        """Names of its joints (``kind="joint"``) or bodies (``"body"``); None if it has no such."""
        ...


def resolve_entities(params: Mapping[str, object], find: Callable[[str], HasNames]) -> dict[str, object]:
    """Parameters of a torch term, with the joints and bodies of each :class:`SceneEntityCfg` as indices.

    Args:
        params: Parameters of the config; they are not changed.
        find: Function that returns an asset or sensor by name.

    Raises:
        ValueError: if an expression matches nothing.
    """
    return {k: v.resolved(find(v.name)) if isinstance(v, SceneEntityCfg) else v for k, v in params.items()}
