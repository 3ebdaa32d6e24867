# SPDX-License-Identifier: Apache-2.0
"""Point instancers: their instances become prims, with the physics of their prototypes."""

from __future__ import annotations

from pxr import Gf, Sdf, Usd, UsdGeom

from .ignored_rows import Ignored
from .stage_access import StageError, walk
from .stage_overlay import StageOverlay

__all__ = ["MAX_INSTANCES", "expand_point_instancers"]

MAX_INSTANCES = 20_000
"""Most instances of a stage: each becomes prims, shapes and perhaps a body."""


def expand_point_instancers(
    edit: StageOverlay, root_path: str, ignore: tuple[str, ...], rows: Ignored, name: str
) -> None:
    """Reference the prototype of each instance below a prim beside the instancer, which is deactivated.

    Invisible and inactive instances are left out. Their bodies move on their own, with the velocities of the
    prototypes; those of the instancer are left out with a row.

    Raises:
        StageError: the arrays of an instancer do not fit together, a prototype does not exist, one instancer is a
            prototype of another, or there are more than :data:`MAX_INSTANCES`.
    """
    paths = [p.GetPath() for p in walk(edit.stage, root_path, ignore) if p.IsA(UsdGeom.PointInstancer)]
    outer = [path for path in paths if not any(path != other and path.HasPrefix(other) for other in paths)]
    total = 0
    for path in outer:
        nested = [other for other in paths if other != path and other.HasPrefix(path)]
        if nested:
            raise StageError(name, str(path), f"has another point instancer as a part, {nested[0]}; author it as prims")
        total += _expand(edit, path, rows, name, MAX_INSTANCES - total)


def _expand(edit: StageOverlay, path: Sdf.Path, rows: Ignored, name: str, room: int) -> int:
    """Expand one instancer; returns the number of its instances."""
    instancer = UsdGeom.PointInstancer(edit.stage.GetPrimAtPath(path))
    prototypes = instancer.GetPrototypesRel().GetForwardedTargets()
    kinds = instancer.GetProtoIndicesAttr().Get() or []
    if reason := _wrong(edit.stage, instancer, prototypes, list(kinds)):
        raise StageError(name, str(path), reason)
    time = Usd.TimeCode.Default()
    mask = list(instancer.ComputeMaskAtTime(time)) or [True] * len(kinds)
    if sum(mask) > room:
        raise StageError(name, str(path), f"has {sum(mask)} instances; a stage may have {MAX_INSTANCES} in all")
    poses = instancer.ComputeInstanceTransformsAtTime(
        time, time, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
    )
    if len(poses) != len(kinds):
        raise StageError(name, str(path), "its poses cannot be computed: positions, orientations and scales must fit")
    for attribute in (instancer.GetVelocitiesAttr(), instancer.GetAngularVelocitiesAttr()):
        if attribute.Get():
            rows.append(
                (str(path), attribute.GetName(), "left out: bodies start with the velocities of the prototypes")
            )
    group = _free_path(edit.stage, path)
    local = UsdGeom.Xformable(instancer).GetLocalTransformation(time)
    resets = UsdGeom.Xformable(instancer).GetResetXformStack()
    edit.prim(path).SetActive(False)
    _place(edit.stage, group, local).SetResetXformStack(resets)
    for index, (kind, shown, pose) in enumerate(zip(kinds, mask, poses, strict=True)):
        if shown:
            _instance(edit.stage, group.AppendChild(f"instance_{index}"), prototypes[kind], pose)
    why = f"each of its {sum(mask)} instances is read as a prim below {group}"
    rows.append((str(path), "point instancer", why))
    return sum(mask)


def _wrong(stage: Usd.Stage, instancer: UsdGeom.PointInstancer, prototypes: list[Sdf.Path], kinds: list[int]) -> str:
    """Problem of the arrays of an instancer; empty if there is none."""
    if lost := [p for p in prototypes if not stage.GetPrimAtPath(p)]:
        return f"its prototype {lost[0]} does not exist"
    if around := [p for p in prototypes if instancer.GetPath().HasPrefix(p)]:
        return f"its prototype {around[0]} holds the instancer itself; name prims beside or below it"
    if outside := [k for k in kinds if not 0 <= k < len(prototypes)]:
        return f"its protoIndices have {outside[0]}, but there are {len(prototypes)} prototypes"
    for attribute in ("positions", "scales", "orientations", "ids"):
        values = instancer.GetPrim().GetAttribute(attribute).Get()
        if values is not None and len(values) != len(kinds) and (len(values) or attribute == "positions"):
            return f"its {attribute} are {len(values)}, its protoIndices {len(kinds)}; author as many"
    if kinds and instancer.GetPositionsAttr().Get() is None:
        return f"has no positions for its {len(kinds)} protoIndices"
    return ""


def _free_path(stage: Usd.Stage, path: Sdf.Path) -> Sdf.Path:
    """A path beside an instancer that no prim has."""
    number = 0
    while stage.GetPrimAtPath(found := path.ReplaceName(f"{path.name}_instances{number or ''}")):
        number += 1
    return found


def _place(stage: Usd.Stage, path: Sdf.Path, pose: Gf.Matrix4d) -> UsdGeom.Xform:
    xform = UsdGeom.Xform.Define(stage, path)
    xform.ClearXformOpOrder()
    # An operation of its own: the prototype's are part of the pose, and stay as they are where it is referenced.
    xform.AddTransformOp(opSuffix="instance").Set(pose)
    return xform


def _instance(stage: Usd.Stage, path: Sdf.Path, prototype: Sdf.Path, pose: Gf.Matrix4d) -> None:
    """A copy of a prototype at a pose; the type is the prototype's."""
    prim = stage.DefinePrim(path)
    prim.GetReferences().AddInternalReference(prototype)
    prim.SetActive(True)
    prim.SetInstanceable(False)
    if prim.IsA(UsdGeom.Xformable):
        xform = UsdGeom.Xformable(prim)
        operation = xform.AddTransformOp(opSuffix="instance")
        operation.Set(pose)
        xform.SetXformOpOrder([operation])
