# SPDX-License-Identifier: Apache-2.0
"""Stage checks: reasons to refuse a stage that it shows itself, before Newton reads it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdLux, UsdPhysics

from .attribute_checks import attribute_reasons
from .attribute_table import MAX_COORDINATE
from .file_errors import last_line
from .mesh_checks import mesh_reason
from .schema_names import misspelt_names
from .stage_access import StageError, api_schemas, stage_name, walk
from .units import stage_units

__all__ = ["check_stage", "outer_prims"]

_MIN_UNIT = 1.0e-9
"""Smallest unit of length and mass, and the inverse of the largest one [m, kg]."""


def check_stage(
    stage: Usd.Stage, root_path: str, ignore: Iterable[str], solver: str, allow_static: bool, name: str | None = None
) -> None:
    """Refuse problems that the stage itself shows.

    Raises:
        StageError: the first reason found.
    """
    name = name or stage_name(stage)
    if not stage.GetPrimAtPath(root_path):
        raise StageError(name, root_path, "there is no such prim to load from")
    _check_units(stage, name)
    prims = list(walk(stage, root_path, ignore))
    for path, reason in _reasons(stage, prims, solver):
        raise StageError(name, path, reason)
    # Last, so that a stage with a better reason is refused for that.
    bodies = any(p.HasAPI(UsdPhysics.RigidBodyAPI) for p in prims)
    if not bodies and not allow_static:
        colliders = sum(p.HasAPI(UsdPhysics.CollisionAPI) for p in prims)
        what = f"only {colliders} static collider(s)" if colliders else "no rigid body and no collider"
        reason = f"nothing to simulate: {what}; apply PhysicsRigidBodyAPI to what should move"
        raise StageError(name, "" if root_path == "/" else root_path, reason)


def _check_units(stage: Usd.Stage, name: str) -> None:
    """Refuse units and up axes that mean nothing."""
    for what, value in zip(("metersPerUnit", "kilogramsPerUnit"), stage_units(stage), strict=True):
        if not _MIN_UNIT <= value <= 1.0 / _MIN_UNIT:
            right = f"it must be positive, from {_MIN_UNIT:g} to {1.0 / _MIN_UNIT:g}, such as 1 or 0.01"
            raise StageError(name, "", f"{what} is {value:g}; {right}")
    up = UsdGeom.GetStageUpAxis(stage)
    if up not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
        raise StageError(name, "", f"upAxis is {up or 'empty'}; it must be Y or Z")


def _reasons(stage: Usd.Stage, prims: list[Usd.Prim], solver: str) -> Iterator[tuple[str, str]]:
    """``(path, reason)`` for everything that keeps the prims from being simulated."""
    for prim in prims:  # first, as the other checks would speak of such a prim's attributes
        yield from ((str(prim.GetPath()), reason) for reason in _deformable(prim))
    for prim in prims:
        yield from ((str(prim.GetPath()), reason) for reason in _prim_reasons(stage, prim, solver))
    for prim in outer_prims(stage, prims):
        yield from ((str(prim.GetPath()), reason) for reason in attribute_reasons(prim))


def outer_prims(stage: Usd.Stage, prims: list[Usd.Prim]) -> list[Usd.Prim]:
    """Physics scenes and materials besides ``prims``, which Newton reads wherever they are."""
    inner = {prim.GetPath() for prim in prims}
    read = [p for p in stage.Traverse() if p.IsA(UsdPhysics.Scene) or p.HasAPI(UsdPhysics.MaterialAPI)]
    return [p for p in read if p.GetPath() not in inner]


def _prim_reasons(stage: Usd.Stage, prim: Usd.Prim, solver: str) -> Iterator[str]:
    body, collider = prim.HasAPI(UsdPhysics.RigidBodyAPI), prim.HasAPI(UsdPhysics.CollisionAPI)
    joint, light = prim.IsA(UsdPhysics.Joint), prim.HasAPI(UsdLux.LightAPI)
    yield from misspelt_names(prim)
    if not prim.IsA(UsdGeom.Camera) and not light:  # which have a place in pictures alone
        yield from attribute_reasons(prim)
    if prim.IsA(UsdGeom.Xformable) and not light:
        yield from _transform(prim, body, body or collider)
    if collider and prim.IsA(UsdGeom.Mesh) and (reason := mesh_reason(prim)):
        yield f"is a mesh collider {reason}; mend the mesh, or remove PhysicsCollisionAPI"
    if joint and UsdPhysics.Joint(prim).GetJointEnabledAttr().Get() is not False:
        yield from _limits(prim)
        yield from _joint(stage, prim, solver)


def _deformable(prim: Usd.Prim) -> Iterator[str]:
    names = [n for n in api_schemas(prim) if "Deformable" in n or "Particle" in n or "NewtonMPM" in n]
    type_name = str(prim.GetTypeName())
    if type_name == "TetMesh" or type_name.startswith("PhysxParticle"):
        names.append(type_name)
    if names:
        yield (
            f"is deformable or made of particles ({names[0]}); this package simulates rigid bodies: "
            "take it out, or add its path to ignore_paths"
        )


def _transform(prim: Usd.Prim, body: bool, solid: bool) -> Iterator[str]:
    try:
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
    except Tf.ErrorException as error:
        yield f"its xformOps cannot be computed ({last_line(error)}); author valid ones"
        return
    if not np.isfinite(matrix).all():
        yield "its world transform is not finite; author finite xformOps"
        return
    if np.abs(matrix).max() > MAX_COORDINATE:
        yield f"its world transform has {np.abs(matrix).max():g}; scales and places must be at most {MAX_COORDINATE:g}"
        return
    scale = np.linalg.norm(matrix[:3, :3], axis=1)  # of the rows, as USD multiplies rows of coordinates
    if not solid:
        return
    if scale.min() < 1e-9:
        yield f"its world scale is zero ({', '.join(f'{s:g}' for s in scale)}); author a scale other than 0"
    elif body and np.linalg.det(matrix[:3, :3]) < 0.0:
        yield "is a rigid body under a mirroring scale; bake the mirror into the meshes and scale the body by 1"


def _limits(prim: Usd.Prim) -> Iterator[str]:
    """A joint of one axis has no range between limits that are the wrong way round."""
    if not prim.IsA(UsdPhysics.RevoluteJoint) and not prim.IsA(UsdPhysics.PrismaticJoint):
        return
    lower, upper = (prim.GetAttribute(f"physics:{end}Limit").Get() for end in ("lower", "upper"))
    # One without a value, as it is blocked, has a reason of its own.
    if lower is not None and upper is not None and lower > upper:
        yield (
            f"physics:lowerLimit {lower:g} is above physics:upperLimit {upper:g}; swap them, "
            "or use a PhysicsFixedJoint for a joint that does not move"
        )


def _joint(stage: Usd.Stage, prim: Usd.Prim, solver: str) -> Iterator[str]:
    joint = UsdPhysics.Joint(prim)
    if prim.IsA(UsdPhysics.DistanceJoint) and solver == "mujoco":
        yield "is a distance joint, which the MuJoCo solver does not take; use another joint, or another solver"
    if any(name.startswith("MjcEquality") for name in api_schemas(prim)):
        return  # an equality constraint may connect sites, so the checks of its bodies do not apply
    ends = {"body0": joint.GetBody0Rel().GetTargets(), "body1": joint.GetBody1Rel().GetTargets()}
    for name, targets in ends.items():  # no target is the world, one that does not exist is a mistake
        if targets and not stage.GetPrimAtPath(targets[0]):
            yield f"its physics:{name} names {targets[0]}, which does not exist; name a body, or none for the world"
            return
    owners = {name: _body_above(stage, targets) for name, targets in ends.items()}
    if not owners["body0"] and not owners["body1"]:
        yield "joins no rigid body: neither physics:body0 nor physics:body1 is one, or stands below one"
    elif owners["body0"] == owners["body1"]:
        yield f"joins rigid body {owners['body0']} to itself; name two bodies"


def _body_above(stage: Usd.Stage, targets: list[Sdf.Path]) -> str:
    """Path of the rigid body at or above a joint's target; empty if there is none."""
    prim = stage.GetPrimAtPath(targets[0]) if targets else None
    while prim and not prim.IsPseudoRoot():
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            return str(prim.GetPath())
        prim = prim.GetParent()
    return ""
