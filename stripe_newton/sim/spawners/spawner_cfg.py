# SPDX-License-Identifier: Apache-2.0
"""What all spawner configs share, and how a prim gets its pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from stripe_newton.configclass import MISSING, configclass

from .schemas import CollisionPropertiesCfg, MassPropertiesCfg, RigidBodyPropertiesCfg

if TYPE_CHECKING:
    from pxr import Usd

__all__ = ["RigidObjectSpawnerCfg", "SpawnerCfg"]

Translation = Sequence[float] | None
"""Position in the parent's frame [m]; ``None`` leaves the prim where it is."""

Orientation = Sequence[float] | None
"""Orientation in the parent's frame as a quaternion (x, y, z, w); ``None`` leaves it."""


@configclass
class SpawnerCfg:
    """Base of the spawner configs: ``cfg.func(prim_path, cfg, translation, orientation)`` authors the prim."""

    func: Callable[..., Any] = MISSING
    """Function that authors the prim and returns it."""
    visible: bool = True
    """Whether the prim is drawn."""
    semantic_tags: list[tuple[str, str]] | None = None
    """Pairs of (type, label), authored as UsdSemantics labels."""
    copy_from_source: bool = True
    """Accepted for compatibility: Newton replicates the model, prims are never copied."""


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
    """Accepted for compatibility: every body can be sensed."""


def place(
    prim: Usd.Prim, translation: Translation, orientation: Orientation, scale: Sequence[float] | None = None
) -> None:
    """Give ``prim`` a pose in its parent's frame, in place of whatever transform operations it came with.

    The operations carry a suffix of their own, so that they never clash in type with those of a referenced asset.
    """
    from pxr import Gf, UsdGeom

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
    xform.ClearXformOpOrder()
    xform.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble, "spawn").Set(position)
    xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble, "spawn").Set(Gf.Quatd(rotation).GetNormalized())
    xform.AddScaleOp(UsdGeom.XformOp.PrecisionDouble, "spawn").Set(size)


def finish(prim: Usd.Prim, cfg: SpawnerCfg) -> Usd.Prim:
    """Apply what every spawner has: visibility and semantic labels."""
    from pxr import UsdGeom, UsdSemantics

    if not cfg.visible:
        UsdGeom.Imageable(prim).MakeInvisible()
    for kind, label in cfg.semantic_tags or ():
        labels = UsdSemantics.LabelsAPI.Apply(prim, kind).CreateLabelsAttr()
        labels.Set([*(labels.Get() or []), label])
    return prim
