# SPDX-License-Identifier: Apache-2.0
"""Stage reader: adds the prims of a stage, and the robot files that some of them stand for, to a builder."""

from __future__ import annotations

import json
from typing import Any

import newton
import warp as wp
from pxr import Usd, UsdGeom

from stripe_newton.robot_files import RobotFileError, extend_report, import_robot_file, rename_model, split_links
from stripe_newton.sim import Simulation
from stripe_newton.sim.spawners.from_files import FILE_KEY
from stripe_newton.sim.spawners.model_names import NAMES_KEY
from stripe_newton.solvers.static_meshes import mark_triangles
from stripe_newton.usd import StageReport, load_stage
from stripe_newton.usd.concave_meshes import concave_colliders, rows_by_distance
from stripe_newton.usd.mesh_approximations import asks_for_distance_field

__all__ = ["read_prims", "use_mujoco_contacts"]


def read_prims(
    sim: Simulation, stage: Usd.Stage, builder: newton.ModelBuilder, root: str, ignore: tuple[str, ...]
) -> StageReport:
    """Read prims of a stage, and the files that they stand for, into a builder.

    Concave meshes that move may need Newton's collision detection, which is then set in the solver's config.

    Args:
        sim: Simulation whose solver the prims are for.
        stage: The stage.
        builder: Builder that gets bodies, joints and shapes.
        root: Path of the prim below which all is read.
        ignore: Expressions for paths that are left out.

    Returns:
        What was read and what was ignored.

    Raises:
        ValueError: if a robot file cannot be read; the error names file and prim.
    """
    files, first = _keyed_prims(stage, FILE_KEY, root, ignore), builder.shape_count
    solver = sim.cfg.solver
    report = load_stage(
        builder,
        stage,
        root_path=root,
        ignore_paths=ignore,
        solver=solver.kind,
        hulls=solver.finds_contacts and not solver.chooses_contacts,
    )
    # Only meshes of the stage: in a robot's file a mesh means its hull.
    if solver.chooses_contacts:
        _choose_mesh_contacts(sim, stage, builder, first, report)
    for prim, options in files:
        extend_report(report, _import_file(builder, prim, options))
    for prim, names in _keyed_prims(stage, NAMES_KEY, root, ignore):
        rename_model(builder, str(prim.GetPath()), names)
    return report


def _choose_mesh_contacts(
    sim: Simulation, stage: Usd.Stage, builder: newton.ModelBuilder, first: int, report: StageReport
) -> None:
    """Mark the concave meshes from shape ``first`` on, and let Newton collide those that move and ask for it."""
    concave = concave_colliders(report.ignored)
    mark_triangles(builder, first, concave)
    moving = concave & _moving(builder, first)
    if as_they_are := {path for path in moving if asks_for_distance_field(stage.GetPrimAtPath(path))}:
        use_mujoco_contacts(sim, False)  # Newton's collision detection takes meshes as they are
        report.ignored = rows_by_distance(report.ignored, as_they_are)
        what = [f"the concave mesh '{path}' that moves as 'sdf'" for path in sorted(as_they_are)]
        sim.newton_contacts_for += tuple(what)


def use_mujoco_contacts(sim: Simulation, value: bool) -> None:
    """Decide what the config of the solver leaves open, in a copy of it."""
    sim.cfg = sim.cfg.replace(solver=sim.cfg.solver.replace(use_mujoco_contacts=value))


def _keyed_prims(
    stage: Usd.Stage, key: str, root: str, ignore: tuple[str, ...]
) -> list[tuple[Usd.Prim, dict[str, Any]]]:
    """Prims below ``root`` with custom data of a key, and these data."""
    prims = (p for p in Usd.PrimRange(stage.GetPrimAtPath(root)) if p.GetCustomDataByKey(key))
    # Where something is ignored it is what lies in the environments: they are loaded with their own root.
    inside = [p for p in prims if not (ignore and str(p.GetPath()).startswith("/World/envs"))]
    return [(p, json.loads(p.GetCustomDataByKey(key))) for p in inside]


def _import_file(builder: newton.ModelBuilder, prim: Usd.Prim, options: dict[str, Any]) -> StageReport:
    """Import the URDF or MJCF file that ``prim`` represents, with labels below its path."""
    own, names = dict(options), json.loads(prim.GetCustomDataByKey(NAMES_KEY) or "{}")
    kind, path = own.pop("format"), own.pop("path")
    pose = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).RemoveScaleShear()
    position, rotation = pose.ExtractTranslation(), pose.ExtractRotationQuat()
    xform = wp.transform(wp.vec3(*position), wp.quat(*rotation.GetImaginary(), rotation.GetReal()))
    try:
        report = import_robot_file(builder, kind, path, own, xform, str(prim.GetPath()))
        split_links(builder, str(prim.GetPath()), names.get("links", {}))
        return report
    except RobotFileError as error:
        raise ValueError(f"{kind.upper()} file at '{prim.GetPath()}': {error}") from error


def _moving(builder: newton.ModelBuilder, first: int) -> set[str]:
    """Labels of the shapes from shape ``first`` on that belong to a body."""
    return {builder.shape_label[i] for i in range(first, builder.shape_count) if builder.shape_body[i] >= 0}
