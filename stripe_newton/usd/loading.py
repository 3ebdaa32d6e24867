# SPDX-License-Identifier: Apache-2.0
"""Stage loading: a USD stage read into a Newton ``ModelBuilder``, or refused with one reason."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import newton
import numpy as np
from newton.solvers import SolverMuJoCo
from newton.usd import SchemaResolverMjc, SchemaResolverNewton, SchemaResolverPhysx
from pxr import Tf, Usd, UsdGeom, UsdPhysics, UsdUtils

from stripe_newton.collision_tables import finalize_without_tables

from .builder_checks import check_builder
from .builder_repairs import articulate_single_joints, open_empty_drives, set_translation_states, unmirror_meshes
from .builder_start import BuilderStart
from .checks import check_stage
from .composition_errors import material_file_rows, without_errors
from .concave_meshes import authored_hull_rows, concave_colliders, concave_mesh_rows, rows_by_distance
from .contact_margins import margin_rows
from .file_errors import last_line
from .flat_meshes import thicken_flat_meshes
from .ignored_rows import Ignored
from .inertia_balance import balance_inertias
from .mesh_approximations import asks_for_distance_field, can_approximate, kept_decompositions, quiet_decomposition
from .newton_warnings import collected_warnings
from .prepare import prepare
from .report_rows import build_report
from .solver_errors import solver_reason
from .stage_access import StageError, first_path, open_stage, stage_name, walk
from .stage_report import StageReport
from .textures import drop_unreadable_textures

__all__ = ["check_content", "inspect_stage", "load_stage"]


def load_stage(
    builder: newton.ModelBuilder,
    stage: str | Path | Usd.Stage,
    *,
    root_path: str = "/",
    ignore_paths: Sequence[str] = (),
    solver: str = "mujoco",
    allow_static: bool = True,
    hulls: bool = False,
) -> StageReport:
    """Read the rigid bodies, joints, shapes and sites of a stage into ``builder``, in SI units and Z up.

    Labels in the builder are prim paths. Every body is part of an articulation: a free body gets a free joint, whose
    coordinates are the body's world pose. Newton sets ``builder.gravity`` from the stage's first PhysicsScene; a
    stage without one leaves it unchanged. The given stage is not changed.

    Args:
        builder: Builder to add to. MuJoCo's custom attributes are registered on it if necessary.
        stage: A file, or an open stage.
        root_path: Prim to load. A PhysicsScene and materials outside it are read too.
        ignore_paths: Regular expressions; prims whose path starts with a match, and those below them, are left out.
        solver: ``"mujoco"`` refuses joints that ``SolverMuJoCo`` does not support; any other name skips that check.
        allow_static: Accept a stage of static colliders, or of visible shapes only.
        hulls: MuJoCo's collision detection is used whatever the shapes: for the rows of concave meshes.

    Raises:
        StageError: the stage cannot be simulated. The content of ``builder`` is then undefined.
    """
    opened = open_stage(stage)
    name, ignore = stage_name(opened), tuple(ignore_paths)
    try:
        check_stage(opened, root_path, ignore, solver, allow_static, name)
        triangles = solver == "mujoco" and not hulls
        prepared, rows = prepare(opened, root_path, ignore, static_triangles=triangles)
    except Tf.ErrorException as error:  # of what no check foresaw
        raise StageError(
            name, first_path(last_line(error), opened), f"USD does not read it: {last_line(error)}"
        ) from error
    rows.extend(material_file_rows(opened))
    start = BuilderStart(builder)
    # Whatever the solver: attributes of MuJoCo's schemas are read into these.
    if solver == "mujoco" or not any(a.namespace == "mujoco" for a in builder.custom_attributes.values()):
        SolverMuJoCo.register_custom_attributes(builder)
    result = _add_usd(builder, prepared, root_path, ignore, name, rows)
    unmirror_meshes(builder, start.shape)
    articulate_single_joints(builder, start.joint, rows)
    set_translation_states(builder, start.joint, prepared)
    open_empty_drives(builder, start.dof)
    rows.extend(drop_unreadable_textures(builder, start.shape))
    if solver == "mujoco":
        rows.extend(thicken_flat_meshes(builder, start.shape, name))
        rows.extend(concave_mesh_rows(builder, start.shape, static_triangles=not hulls))
        rows.extend(margin_rows(builder, start.shape))
    rows.extend(authored_hull_rows(builder, start.shape, prepared))
    # After the repairs: what they mend is no reason to refuse.
    check_builder(builder, start, solver, name)
    rows.extend(balance_inertias(builder, start.body))
    if not can_approximate():
        rows.extend(_unapproximated(prepared, root_path, ignore))
    scene = result["physics_scene_path"]
    return build_report(builder, start, opened, prepared, root_path, ignore, rows, name, scene)


def _add_usd(
    builder: newton.ModelBuilder, stage: Usd.Stage, root_path: str, ignore: tuple[str, ...], name: str, rows: Ignored
) -> dict[str, Any]:
    """Let Newton's importer read a stage that was prepared for it.

    Raises:
        StageError: it does not support the stage.
    """
    quiet_decomposition()
    with kept_decompositions(stage, name), _warnings_as_rows(rows, stage):
        try:
            return builder.add_usd(
                without_errors(stage),
                root_path=root_path,
                ignore_paths=list(ignore),
                # The first that has an attribute decides: Newton's own schemas, then MuJoCo's, then PhysX's.
                schema_resolvers=[SchemaResolverNewton(), SchemaResolverMjc(), SchemaResolverPhysx()],
                load_sites=True,
                load_visual_shapes=True,
                skip_mesh_approximation=not can_approximate(),
            )
        except Exception as error:  # whatever a stage brings that the importer does not expect
            text = last_line(error) if isinstance(error, Tf.ErrorException) else " ".join(str(error).split())
            kind = "" if type(error) in (ValueError, RuntimeError) else f"{type(error).__name__}: "
            reason = f"Newton does not read it: {kind}{text or type(error).__name__}"
            raise StageError(name, first_path(text, stage), reason) from error


def inspect_stage(path: str | Path | Usd.Stage, *, solver: str = "mujoco") -> StageReport:
    """Report on a stage, read as :func:`load_stage` reads it.

    Raises:
        StageError: the stage cannot be simulated, or there is nothing in it.
    """
    builder, stage = newton.ModelBuilder(), open_stage(path)
    report = load_stage(builder, stage, solver=solver)
    if solver == "mujoco":
        moving = {builder.shape_label[s] for s in range(builder.shape_count) if builder.shape_body[s] >= 0}
        concave = sorted(concave_colliders(report.ignored) & moving)
        as_they_are = [path for path in concave if asks_for_distance_field(stage.GetPrimAtPath(path))]
        report.ignored = rows_by_distance(report.ignored, as_they_are)
    check_content(builder, report)
    if builder.body_count:
        try:
            report.ignored.extend(_moved_bodies(builder))
        except ValueError as error:  # of what no check foresaw
            labels = [*builder.body_label, *builder.joint_label, *builder.shape_label]
            raise StageError(report.file, *solver_reason(labels, error)) from error
    return report


def check_content(builder: newton.ModelBuilder, report: StageReport) -> None:
    """Add a row to the report of a whole stage in which nothing moves.

    Raises:
        StageError: there is nothing in it at all.
    """
    if not builder.body_count and not builder.shape_count:
        reason = "nothing in it has a shape: neither a rigid body, nor a collider, nor anything to see"
        raise StageError(report.file, "", reason)
    if not builder.joint_count:
        report.ignored.append(("/", "static stage", "nothing moves: no prim has an enabled PhysicsRigidBodyAPI"))


def _moved_bodies(builder: newton.ModelBuilder) -> Iterator[tuple[str, str, str]]:
    """Rows of bodies whose authored pose differs from the one that their joints' frames and positions give."""
    # The simulation starts where forward kinematics puts the bodies, not where the stage shows them.
    model = finalize_without_tables(builder, "cpu")
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    for label, authored, simulated in zip(builder.body_label, builder.body_q, state.body_q.numpy(), strict=True):
        pose = np.array(authored, dtype=np.float32)
        moved = float(np.linalg.norm(pose[:3] - simulated[:3]))
        # The scalar product of two unit quaternions is the cosine of half the angle between them, or its negative.
        turned = 2.0 * float(np.arccos(min(1.0, abs(float(pose[3:] @ simulated[3:])))))
        if moved > 1e-3 or turned > 1e-2:
            what = f"its joints put it {moved:.3g} m and {np.degrees(turned):.3g} degrees from there"
            yield label, "authored pose", what


def _unapproximated(stage: Usd.Stage, root_path: str, ignore: tuple[str, ...]) -> Iterator[tuple[str, str, str]]:
    for prim in walk(stage, root_path, ignore):
        if prim.IsA(UsdGeom.Mesh) and prim.HasAPI(UsdPhysics.MeshCollisionAPI):
            kind = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get()
            if kind not in (None, "none", "convexHull"):
                yield str(prim.GetPath()), f"approximation {kind}", "scipy is not installed: a convex hull is used"


@contextmanager
def _warnings_as_rows(rows: Ignored, stage: Usd.Stage) -> Iterator[None]:
    """Collect warnings of Newton and of OpenUSD's parser as rows of the report."""
    usd = UsdUtils.CoalescingDiagnosticDelegate()
    with collected_warnings() as texts:
        yield
    # The same text may come by both ways, and for many prims.
    rows.extend(("", "warning of Newton", text) for text in dict.fromkeys(texts))
    told = dict.fromkeys(str(d.commentary).strip() for d in usd.TakeUncoalescedDiagnostics())
    rows.extend((first_path(text, stage), "warning of OpenUSD", text) for text in told)
