# SPDX-License-Identifier: Apache-2.0
"""Scenery stage: a stage that somebody else wrote, copied below one prim of the stage of a scene."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from stripe_newton.robot_files import file_kind, mjcf_stage
from stripe_newton.usd import StageError, converted, open_stage, stage_name
from stripe_newton.usd.checks import check_stage
from stripe_newton.usd.ignored_rows import Ignored
from stripe_newton.usd.semantic_labels import read_semantics

from .scenery_options import SceneryOptionsCfg

__all__ = ["SceneryStage", "author_scenery", "paths_pattern"]


@dataclass
class SceneryStage:
    """An imported stage below one prim.

    Attributes:
        file: The file.
        path: Path of the prim.
        bodies: Paths of its rigid bodies.
        not_static: Expression of the prims that move, which are left out of what all environments share; empty if
            nothing moves.
        not_moving: Expression of the prims that do not move, which are left out of the environments.
        labels: First semantic label of each prim that has one, by path.
        rows: What was converted, for the report.
    """

    file: str
    path: str
    bodies: list[str] = field(default_factory=list)
    not_static: str = ""
    not_moving: str = ""
    labels: dict[str, str] = field(default_factory=dict)
    rows: Ignored = field(default_factory=list)


def author_scenery(
    stage: Usd.Stage, file: str, options: SceneryOptionsCfg, solver: str, ground: str | None
) -> SceneryStage:
    """Copy a stage below a prim of another, in metres, kilograms and Z up.

    That prim is ``GROUND/scenery`` where the scene has a ground, so that the paths of sensors and filters that name the
    ground find the scenery too, else ``/World/scenery``.

    Args:
        stage: The stage of a scene.
        file: The USD file, or an MJCF file, of which what stands still is read.
        options: Where it stands.
        solver: Kind of the solver, for joints that it does not take.
        ground: Path of the scene's ground; None without one.

    Raises:
        StageError: if it cannot be simulated, or nothing in it collides.
        RobotFileError: MuJoCo refuses the MJCF file.
    """
    source, name, missing = _open(Path(file).expanduser())
    check_stage(source, "/", (), solver, True, name)
    in_si, rows = converted(source)
    _check_colliders(in_si, name, options)
    layer = in_si.Flatten()
    path = _free_path(stage, source, _parent(stage, ground))
    root = UsdGeom.Xform.Define(stage, str(path))
    target = stage.GetRootLayer()
    with Sdf.ChangeBlock():  # else OpenUSD complains of arcs to the old paths
        for prim in layer.rootPrims:
            Sdf.CopySpec(layer, prim.path, target, path.AppendChild(prim.name))
        _retarget(target, path)
    root.AddTransformOp().Set(_placement(source, options))
    made = SceneryStage(file, str(path))
    made.rows = [(str(path) + where.rstrip("/"), what, why) for where, what, why in rows]
    made.rows += [(f"{path}/{where}", what, why) for where, what, why in missing]
    if options.visuals_collide:
        _make_colliders(stage, path)
    _sort_prims(stage.GetPrimAtPath(path), made)
    for prim_path, kinds in read_semantics(stage, str(path)).items():
        made.labels[prim_path] = next(iter(kinds.values()))[0]
    return made


def _open(path: Path) -> tuple[Usd.Stage, str, Ignored]:
    """The stage of a file, its name for messages, and rows of what it lacks.

    Raises:
        StageError: if it is neither a USD nor an MJCF file, or refers to something that is not there.
        RobotFileError: MuJoCo refuses the MJCF file.
    """
    kind = file_kind(path)
    if kind.name == "mjcf":
        stage, rows = mjcf_stage(path)
        return stage, str(path), list(rows)
    if kind.name == "urdf" or (not kind.name and path.suffix.lower() in (".xml", ".mjcf", ".urdf", ".sdf", ".xacro")):
        advice = "; scenery is a USD or MJCF file, and a robot an asset of the scene"
        raise StageError(str(path), "", f"{kind.description}{advice if kind.name else ''}")
    source = open_stage(path)
    return source, stage_name(source), []


def _check_colliders(stage: Usd.Stage, name: str, options: SceneryOptionsCfg) -> None:
    """Refuse a stage in which nothing that stands still collides.

    Raises:
        StageError: with the number of visible shapes, which could collide.
    """
    prims = list(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    shapes = [p for p in prims if p.IsA(UsdGeom.Gprim) and not _body_of(p)]
    solid = [p for p in shapes if p.HasAPI(UsdPhysics.CollisionAPI)]
    if solid or (shapes and options.visuals_collide):
        return
    reason = "has no static collider: no prim outside of rigid bodies has a PhysicsCollisionAPI"
    if shapes:
        reason += (
            f", {len(shapes)} have a shape; apply the API, or make all of them collide with "
            "scenery_options.visuals_collide=True"
        )
    raise StageError(name, "", reason)


def _parent(stage: Usd.Stage, ground: str | None) -> str:
    """Prim to put the stage below: the ground, if that is no shape itself and is not moved, else ``/World``."""
    prim = stage.GetPrimAtPath(ground) if ground is not None else None
    if not prim or prim.IsA(UsdGeom.Gprim) or prim.HasAuthoredReferences():
        return "/World"
    still = UsdGeom.XformCache().GetLocalToWorldTransform(prim) == Gf.Matrix4d(1.0)
    return str(prim.GetPath()) if still else "/World"


def _free_path(stage: Usd.Stage, source: Usd.Stage, parent: str) -> Sdf.Path:
    """A path that neither of two stages has, so that no path of the one is taken for a path of the other."""
    number, path = 1, Sdf.Path(f"{parent}/scenery")
    while stage.GetPrimAtPath(path) or source.GetPrimAtPath(path):
        number += 1
        path = Sdf.Path(f"{parent}/scenery_{number}")
    return path


def _retarget(layer: Sdf.Layer, root: Sdf.Path) -> None:
    """Move targets and arcs of copied prims that lead to other copied prims: copying moves those below the same one."""

    def moved(path: Sdf.Path) -> Sdf.Path:
        return path if path.isEmpty or path.HasPrefix(root) else path.ReplacePrefix(Sdf.Path.absoluteRootPath, root)

    def moved_arc(arc: Any) -> Any:  # Sdf.Reference or Sdf.Payload, which have no common base
        return arc if arc.assetPath else type(arc)("", moved(arc.primPath), arc.layerOffset)

    found: list[Sdf.Path] = []
    layer.Traverse(root, found.append)
    for path in found:
        spec = layer.GetObjectAtPath(path)
        edits: list[tuple[str, Callable[[Any], Any]]] = []
        if isinstance(spec, Sdf.RelationshipSpec):
            edits = [("targetPathList", moved)]
        elif isinstance(spec, Sdf.AttributeSpec):
            edits = [("connectionPathList", moved)]
        elif isinstance(spec, Sdf.PrimSpec):
            edits = [("referenceList", moved_arc), ("payloadList", moved_arc)]
            edits += [("inheritPathList", moved), ("specializesList", moved)]
        for name, edit in edits:
            getattr(spec, name).ModifyItemEdits(edit)


def _placement(source: Usd.Stage, options: SceneryOptionsCfg) -> Gf.Matrix4d:
    """Transform of the whole stage; USD's matrices act on rows, so what comes first stands first."""
    x, y, z, w = options.rot
    upright = Gf.Matrix4d(1.0)
    if UsdGeom.GetStageUpAxis(source) == UsdGeom.Tokens.y:
        upright.SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), 90.0))
    pose = Gf.Matrix4d().SetTransform(Gf.Rotation(Gf.Quatd(w, x, y, z).GetNormalized()), Gf.Vec3d(*options.pos))
    return upright * Gf.Matrix4d().SetScale(options.scale) * pose


def _make_colliders(stage: Usd.Stage, path: Sdf.Path) -> None:
    """Make colliders of all visible shapes that belong to no body; meshes collide by their triangles."""
    while instances := [p for p in Usd.PrimRange(stage.GetPrimAtPath(path)) if p.IsInstance()]:
        for prim in instances:  # USD edits no prim inside of an instance
            prim.SetInstanceable(False)
    for prim in Usd.PrimRange(stage.GetPrimAtPath(path)):
        image = UsdGeom.Imageable(prim)
        if not prim.IsA(UsdGeom.Gprim) or _body_of(prim) or prim.HasAPI(UsdPhysics.CollisionAPI):
            continue
        if image.ComputeVisibility() == UsdGeom.Tokens.invisible or image.ComputePurpose() == UsdGeom.Tokens.guide:
            continue
        UsdPhysics.CollisionAPI.Apply(prim)
        if prim.IsA(UsdGeom.Mesh):
            UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.none)


def _sort_prims(root: Usd.Prim, made: SceneryStage) -> None:
    """Fill in which prims move and which do not.

    Raises:
        StageError: if a static collider has a rigid body below it, so that neither can be left out alone.
    """
    prims = list(Usd.PrimRange(root, Usd.TraverseInstanceProxies()))
    made.bodies = [str(p.GetPath()) for p in prims if _is_body(p)]
    if not made.bodies:
        return
    joints = [str(p.GetPath()) for p in prims if p.IsA(UsdPhysics.Joint)]
    made.not_static = paths_pattern(_outermost([*made.bodies, *joints]))
    needed = [p for p in prims if _is_body(p) or p.IsA(UsdPhysics.Joint) or _is_setting(p)]
    above = {path for p in needed for path in p.GetPath().GetPrefixes()}
    inside = re.compile(made.not_static)
    static = [p for p in prims if p.GetPath() not in above and not inside.match(str(p.GetPath()))]
    for prim in prims:
        if prim.GetPath() in above and prim.HasAPI(UsdPhysics.CollisionAPI) and not _body_of(prim):
            reason = "is a static collider with a rigid body or joint below it; put that beside it"
            raise StageError(made.file, str(prim.GetPath()).removeprefix(made.path), reason)
    made.not_moving = paths_pattern(_outermost([str(p.GetPath()) for p in static]))


def _is_body(prim: Usd.Prim) -> bool:
    return prim.HasAPI(UsdPhysics.RigidBodyAPI) and UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get()


def _is_setting(prim: Usd.Prim) -> bool:
    """Whether a prim says how others behave rather than being something itself."""
    return any(prim.IsA(kind) for kind in (UsdPhysics.Scene, UsdPhysics.CollisionGroup, UsdShade.Material))


def _body_of(prim: Usd.Prim) -> Usd.Prim | None:
    """The rigid body that a prim belongs to; None if it stands still."""
    while prim and not prim.IsPseudoRoot():
        if _is_body(prim):
            return prim
        prim = prim.GetParent()
    return None


def _outermost(paths: list[str]) -> list[str]:
    """The paths that lie below no other one of them."""
    kept: list[str] = []
    for path in sorted(paths, key=lambda p: p.split("/")):
        if not kept or not path.startswith(kept[-1] + "/"):
            kept.append(path)
    return kept


def paths_pattern(paths: list[str]) -> str:
    """An expression that matches some paths and those below them, and no others that begin in the same way."""
    # Newton takes what has no ".*" in it for a path.
    return f"(?:{'|'.join(map(re.escape, paths))})(/.*)?$"
