# SPDX-License-Identifier: Apache-2.0
"""Scene entities in the configs of terms: an asset or a sensor by name, and some of its joints or bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from stripe_newton.configclass import configclass
from stripe_newton.matching import match_names

__all__ = ["SceneEntityCfg", "names_of", "resolve_entities"]


@configclass
class SceneEntityCfg:
    """An asset of the scene by name; joints and bodies by expression or index, all of them by default."""

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
    """Order of the expressions rather than of the asset."""

    def chooses(self, kind: str) -> bool:
        """Whether it says which joints (``kind="joint"``) or bodies (``"body"``) are meant."""
        return any(getattr(self, f"{kind}_{what}") is not None for what in ("names", "ids"))

    def indices(self, kind: str, names: Sequence[str]) -> list[int]:
        """Indices of the joints (``kind="joint"``) or bodies (``"body"``) meant.

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


def names_of(thing: object, kind: str) -> list[str] | None:
    """Names of the joints (``kind="joint"``) or bodies (``"body"``) of an asset or sensor; None if it has no such."""
    for owner in (getattr(thing, "data", None), thing):
        if hasattr(owner, f"{kind}_names"):
            return list(getattr(owner, f"{kind}_names"))
    return None


def resolve_entities(params: Mapping[str, object], find: Callable[[str], object]) -> dict[str, object]:
    """The parameters of a torch term, in which a :class:`SceneEntityCfg` has its joints and bodies as indices.

    Args:
        params: What the config says; it stays as it is.
        find: Asset or sensor by name.

    Raises:
        ValueError: if an expression matches nothing.
    """
    given = dict(params)
    for key, value in params.items():
        if isinstance(value, SceneEntityCfg):
            thing = find(value.name)
            ids = {f"{kind}_ids": (kind, names_of(thing, kind)) for kind in ("joint", "body")}
            found = {k: value.indices(kind, names) for k, (kind, names) in ids.items() if names is not None}
            given[key] = value.replace(**found)
    return given
