# SPDX-License-Identifier: Apache-2.0
"""Spawner configs: the base of all, and how a spawned prim gets its pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

from pxr import Gf, Usd, UsdGeom, UsdSemantics

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import Seed

from .schemas import CollisionPropertiesCfg, MassPropertiesCfg, RigidBodyPropertiesCfg

__all__ = ["RigidObjectSpawnerCfg", "SceneSpawnerCfg", "SpawnerCfg"]

Translation = Sequence[float] | None
"""Position in the parent's frame [m]; ``None`` leaves the prim where it is."""

Orientation = Sequence[float] | None
"""Orientation in the parent's frame as a quaternion (x, y, z, w); ``None`` leaves it."""


@configclass
class SpawnerCfg:
    """Base of the spawner configs: ``cfg.func(prim_path, cfg, translation, orientation)`` authors the prim."""

    func: Callable[..., Usd.Prim] = MISSING
    """Function that authors the prim and returns it."""
    visible: bool = True
    """Whether the prim is drawn."""
    semantic_tags: list[tuple[str, str]] | None = None
    """Pairs of (type, label), authored as UsdSemantics labels."""
    copy_from_source: bool = True
    """Ignored: Newton replicates the model, prims are never copied."""

    def spawn(self, prim_path: str, translation: Translation = None, orientation: Orientation = None) -> Usd.Prim:
        """Call :attr:`func`; a subclass may hand it the orientation in another order.

        Args:
            prim_path: Path of the new prim.
            translation: Position in the parent's frame [m].
            orientation: Quaternion (x, y, z, w) in the parent's frame.
        """
        return self.func(prim_path, self, translation, orientation)

    IGNORED: ClassVar[dict[str, str]] = {"copy_from_source": "Newton replicates the model, prims are never copied"}


@configclass
class RigidObjectSpawnerCfg(SpawnerCfg):
    """Base of the spawners that can make a rigid body."""

    mass_props: MassPropertiesCfg | None = None
    """Mass; ``None`` leaves it to the density of the colliders."""
    rigid_props: RigidBodyPropertiesCfg | None = None
    """Makes the prim a rigid body; ``None`` leaves it static."""
    collision_props: CollisionPropertiesCfg | None = None
    """Makes the shape a collider; ``None`` leaves it visual."""
    activate_contact_sensors: bool = False
    """For configs of Isaac Lab. It need not be set: contacts of every body can be sensed."""


@configclass
class SceneSpawnerCfg(SpawnerCfg):
    """Base of the spawners that make a whole scene from a seed, so that ``scene.regenerate`` can make another."""

    seed: Seed = 0
    """Seed of the scene."""

    def made_stage(self) -> Usd.Stage:
        """The stage of the scene with this seed."""
        raise NotImplementedError

    def why_not_regenerable(self) -> str:
        """Reason why there is no scene with another seed, and what to do about it; empty if there is."""
        return ""


def place(
    prim: Usd.Prim, translation: Translation, orientation: Orientation, scale: Sequence[float] | None = None
) -> None:
    """Give ``prim`` a pose in its parent's frame, in place of whatever transform operations it came with."""
    if translation is None and orientation is None and scale is None:
        return
    xform = UsdGeom.Xformable(prim)
    old = Gf.Transform(xform.GetLocalTransformation())
    position = Gf.Vec3d(*map(float, translation)) if translation is not None else old.GetTranslation()
    rotation = old.GetRotation().GetQuat()
    if orientation is not None:
        x, y, z, w = map(float, orientation)
        rotation = Gf.Quatd(w, x, y, z)
    size = Gf.Vec3d(*map(float, scale)) if scale is not None else old.GetScale()
    # A suffix of their own keeps these operations from clashing in type with those of a referenced asset: its
    # attributes stay where they are, only their order is cleared.
    xform.ClearXformOpOrder()
    xform.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble, "spawn").Set(position)
    xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble, "spawn").Set(Gf.Quatd(rotation).GetNormalized())
    xform.AddScaleOp(UsdGeom.XformOp.PrecisionDouble, "spawn").Set(size)


def finish(prim: Usd.Prim, cfg: SpawnerCfg) -> Usd.Prim:
    """Apply what every spawner has: visibility and semantic labels."""
    if not cfg.visible:
        UsdGeom.Imageable(prim).MakeInvisible()
    for kind, label in cfg.semantic_tags or ():
        labels = UsdSemantics.LabelsAPI.Apply(prim, kind).CreateLabelsAttr()
        labels.Set([*(labels.Get() or []), label])
    return prim
