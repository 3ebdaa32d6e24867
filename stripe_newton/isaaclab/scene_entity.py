# SPDX-License-Identifier: Apache-2.0
"""Scene entity of the Isaac Lab dialect: Isaac Lab's fields, and slices where all joints or bodies are meant."""

from __future__ import annotations

from collections.abc import Sequence

from stripe_newton.assets import RigidObjectCollection
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import SceneEntityCfg as NativeSceneEntityCfg
from stripe_newton.fusion.scene_entity import HasNames
from stripe_newton.scene import InteractiveScene

__all__ = ["SceneEntityCfg"]

Ids = Sequence[int] | slice
_ALL = slice(None)


@configclass
class SceneEntityCfg(NativeSceneEntityCfg):
    """:class:`stripe_newton.managers.SceneEntityCfg`; ``joint_ids`` and ``body_ids`` that mean all are a slice."""

    name: str = MISSING
    joint_ids: Ids | None = _ALL
    body_ids: Ids | None = _ALL
    fixed_tendon_names: str | Sequence[str] | None = None
    fixed_tendon_ids: Ids = _ALL
    object_collection_names: str | Sequence[str] | None = None
    object_collection_ids: Ids = _ALL

    def chooses(self, kind: str) -> bool:
        """Whether it names some joints or bodies."""
        return getattr(self, f"{kind}_names") is not None or getattr(self, f"{kind}_ids") not in (None, _ALL)

    def resolved(self, thing: HasNames) -> SceneEntityCfg:
        """A copy with the chosen joints and bodies as names and indices, or as a slice where all are chosen."""
        made: SceneEntityCfg = self.replace()
        made.resolve_names(thing)
        return made

    def resolve(self, scene: InteractiveScene) -> None:
        """Find the indices of the joints and bodies that the config names, in place.

        Raises:
            KeyError: the scene has no such asset or sensor.
            ValueError: an expression matches nothing.
        """
        self.resolve_names(scene[self.name])

    def resolve_names(self, thing: HasNames) -> None:
        """:meth:`resolve` with the asset or sensor itself."""
        for kind in ("joint", "body"):
            names = thing.names_of(kind)
            if names is None or not self.chooses(kind):
                continue
            ids = self.indices(kind, names)
            setattr(self, f"{kind}_names", [names[i] for i in ids])
            setattr(self, f"{kind}_ids", _ALL if ids == list(range(len(names))) else ids)
        if isinstance(thing, RigidObjectCollection) and self.object_collection_names is not None:
            found, chosen = thing.find_objects(self.object_collection_names, self.preserve_order)
            self.object_collection_names = chosen
            self.object_collection_ids = _ALL if len(chosen) == thing.num_objects else found.tolist()
