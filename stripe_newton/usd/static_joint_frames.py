# SPDX-License-Identifier: Apache-2.0
"""Static joint frames: joints on a static collider, such as a door on a wall, become joints on the world there."""

from __future__ import annotations

from collections.abc import Iterable

from pxr import Gf, Usd, UsdGeom, UsdPhysics

from .stage_overlay import StageOverlay

__all__ = ["joints_to_world"]


def joints_to_world(edit: StageOverlay, prims: Iterable[Usd.Prim]) -> None:
    """Express frames of joints on static colliders in the world, and name no body there.

    UsdPhysics counts a frame from the prim that is named, moving or not. Newton knows moving bodies alone: it would
    count one on a static collider from the origin of the world, and a door would hang far from its wall. Bodies that a
    joint connects do not collide unless it says so; this holds for a static collider, too.

    Args:
        edit: The stage.
        prims: Its prims; bodies that are not enabled have lost their schema.
    """
    found = [
        (prim.GetPath(), side, collider)
        for prim in prims
        if prim.IsA(UsdPhysics.Joint)
        for side in (0, 1)
        if (collider := _static_collider(prim, side)) is not None
    ]
    for path, side, collider in found:
        joint = UsdPhysics.Joint(edit.prim(path))
        body, other = joint.GetBody0Rel(), joint.GetBody1Rel()
        position, rotation = joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()
        if side == 1:
            body, other = other, body
            position, rotation = joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()
        world = UsdGeom.XformCache().GetLocalToWorldTransform(edit.stage.GetPrimAtPath(collider.GetPath()))
        turned = world.RemoveScaleShear().ExtractRotationQuat() * Gf.Quatd(rotation.Get())
        position.Set(Gf.Vec3f(world.Transform(Gf.Vec3d(position.Get()))))
        rotation.Set(Gf.Quatf(turned.GetNormalized()))
        body.SetTargets([])
        if not joint.GetCollisionEnabledAttr().Get() and (targets := other.GetTargets()):
            pairs = UsdPhysics.FilteredPairsAPI.Apply(edit.prim(collider.GetPath()))
            pairs.CreateFilteredPairsRel().AddTarget(targets[0])


def _static_collider(joint: Usd.Prim, side: int) -> Usd.Prim | None:
    """The static collider that a joint names as its body 0 or 1; None if it names something else."""
    targets = joint.GetRelationship(f"physics:body{side}").GetTargets()
    prim = joint.GetStage().GetPrimAtPath(targets[0]) if targets else Usd.Prim()
    if not prim or not prim.HasAPI(UsdPhysics.CollisionAPI):
        return None
    above = prim
    while above and not above.IsPseudoRoot():
        if above.HasAPI(UsdPhysics.RigidBodyAPI):
            return None
        above = above.GetParent()
    return prim
