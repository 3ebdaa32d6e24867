# SPDX-License-Identifier: Apache-2.0
"""Stage reader: adds the prims of a stage, and the robot files that some of them stand for, to a builder."""

from __future__ import annotations

import newton
from pxr import Usd

from stripe_newton.robot_files import extend_report
from stripe_newton.sim import Simulation
from stripe_newton.solvers.static_meshes import mark_triangles
from stripe_newton.usd import StageReport, load_stage
from stripe_newton.usd.concave_meshes import concave_colliders, rows_by_distance
from stripe_newton.usd.mesh_approximations import asks_for_distance_field

from .represented_files import rename_prims, represented_files

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
        StageError: if what a spawner keeps with a prim is not that.
        ValueError: if a robot file cannot be read; the error names file and prim.
    """
    files, first = represented_files(stage, root, ignore), builder.shape_count
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
    for file in files:
        extend_report(report, file.add_to(builder))
    rename_prims(builder, stage, root, ignore)
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


def _moving(builder: newton.ModelBuilder, first: int) -> set[str]:
    """Labels of the shapes from shape ``first`` on that belong to a body."""
    return {builder.shape_label[i] for i in range(first, builder.shape_count) if builder.shape_body[i] >= 0}
