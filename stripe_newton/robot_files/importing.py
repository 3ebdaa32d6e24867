# SPDX-License-Identifier: Apache-2.0
"""Robot file import: a URDF or MJCF file read into a Newton ``ModelBuilder`` with a report, or refused by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import newton
import warp as wp
from newton import GeoType, ShapeFlags
from newton.solvers import SolverMuJoCo
from pxr import Usd, UsdGeom

from stripe_newton.matching import match_values
from stripe_newton.usd import StageReport
from stripe_newton.usd.attribute_table import MAX_COORDINATE
from stripe_newton.usd.body_masses import MUJOCO_MINIMUM, mass_problems
from stripe_newton.usd.builder_checks import shape_extent
from stripe_newton.usd.builder_start import BuilderStart
from stripe_newton.usd.concave_meshes import concave_meshes
from stripe_newton.usd.contact_margins import margin_rows
from stripe_newton.usd.inertia_balance import balance_inertias
from stripe_newton.usd.report_rows import build_report
from stripe_newton.usd.textures import drop_unreadable_textures

from .error import RobotFileError
from .file_kind import file_kind
from .importer_warnings import warnings_as_rows
from .mjcf import MjcfStart, complete_mjcf
from .mjcf_edits import edit_mjcf
from .mjcf_joint_frames import anchor_hinges, joint_motion_rows
from .mjcf_masses import take_compiled_masses
from .mjcf_rows import mjcf_rows
from .mjcf_sites import tie_sites
from .mjcf_tied_bodies import let_tied_bodies_collide
from .mjcf_visibility import show_drawn_colliders
from .urdf import prepare_urdf
from .urdf_checks import Row, undecided_root

__all__ = ["extend_report", "import_robot_file", "inspect_robot_file"]

_SMALLEST_RANGE = 1e-5
"""Half the range of a locked joint [rad, m], and the effort of a drive without any [N m, N]."""
_NO_BODIES = "has no bodies: geometry of the world alone is no robot; a scene that stands still is imported as USD"


def import_robot_file(
    builder: newton.ModelBuilder,
    kind: str,
    path: str | Path,
    options: dict[str, Any],
    xform: wp.transform | None = None,
    label: str = "",
) -> StageReport:
    """Read a robot's file into ``builder``.

    Args:
        builder: Builder to add to.
        kind: ``"urdf"`` or ``"mjcf"``.
        path: The file.
        options: Options of Newton's importer; for URDF ``packages`` too, for MJCF ``keyframe``.
        xform: Pose of the file's world frame.
        label: Put before the labels of what the file brings, as a path; the articulation, if it is one, gets this one.

    Returns:
        What was read; its rows ``ignored`` say what was left out, read differently from what the file says, or changed.

    Raises:
        RobotFileError: everything that is wrong with the file, by the names of its elements.
    """
    path, rows, start = Path(path), list[Row](), BuilderStart(builder)
    found = file_kind(path)
    if found.name != kind:
        raise RobotFileError(path, [found.description])
    try:
        with warnings_as_rows(rows):
            rows += (_add_urdf if kind == "urdf" else _add_mjcf)(builder, path, options, xform)
    except RobotFileError:
        raise
    except Exception as error:  # Newton's importers raise whatever their libraries do
        raise RobotFileError(path, [str(error) or type(error).__name__]) from error
    if builder.body_count == start.body:
        raise RobotFileError(path, [_NO_BODIES])
    rows += _planes_to_world(builder, start)
    if problems := [*_large_shapes(builder, start), *_mass_problems(builder, start)]:
        raise RobotFileError(path, problems)
    rows += [(where.rpartition("/")[2], what, why) for where, what, why in balance_inertias(builder, start.body)]
    textures = drop_unreadable_textures(builder, start.shape)
    rows += [(where.rpartition("/")[2], what, why) for where, what, why in textures]
    rows += [(where.rpartition("/")[2], what, why) for where, what, why in margin_rows(builder, start.shape)]
    if kind == "urdf":  # MuJoCo's format means the hull
        names = [builder.shape_label[s].rpartition("/")[2] for s, _ in concave_meshes(builder, start.shape)]
        rows += [(name, "concave mesh collider", "its convex hull collides") for name in names]
    _collide_by_hulls(builder, start)
    _prefix_labels(builder, start, label)
    rows = [(f"{label}/{where}" if label else where, what, why) for where, what, why in _grouped(rows)]
    return _report(builder, start, path, label, rows)


def inspect_robot_file(path: str | Path) -> StageReport:
    """Report on a URDF or MJCF file, read with the importer's usual options.

    The root of a URDF file that does not say whether it floats is held in the world, and a row says so.

    Raises:
        RobotFileError: the file cannot be simulated.
    """
    kind, builder = file_kind(path), newton.ModelBuilder()
    if kind.name not in ("urdf", "mjcf"):
        raise RobotFileError(path, [kind.description])
    SolverMuJoCo.register_custom_attributes(builder)
    root = undecided_root(ElementTree.parse(path).getroot()) if kind.name == "urdf" else ""
    report = import_robot_file(builder, kind.name, path, {"floating": False if root else None})
    if root:
        why = "the file does not say whether it floats: here it is held; a scene wants fix_base=True or False"
        report.ignored.insert(0, (root, "root link", why))
    return report


def extend_report(report: StageReport, other: StageReport) -> None:
    """Add the rows of another report to those of a stage that has the file."""
    for field in dataclasses.fields(StageReport):
        value = getattr(report, field.name)
        if isinstance(value, list):
            value.extend(getattr(other, field.name))


def _add_urdf(
    builder: newton.ModelBuilder, path: Path, options: dict[str, Any], xform: wp.transform | None
) -> list[Row]:
    own = dict(options)
    packages, visuals = own.pop("packages", None), own.get("parse_visuals_as_colliders", False)
    gains = own.pop("joint_stiffness", None), own.pop("joint_damping", None)
    capsules, merge = own.pop("replace_cylinders_with_capsules", False), own.pop("collapse_fixed_joints", False)
    custom = {str(attribute.urdf_attribute_name) for attribute in builder.custom_attributes.values()}
    text, rows = prepare_urdf(path, own.get("floating"), packages, visuals, custom)
    start = BuilderStart(builder)
    builder.add_urdf(text, xform=xform, **own)
    _open_empty_ranges(builder, start.dof)
    _set_gains(builder, start, *gains)
    if capsules:
        _round_cylinders(builder, start.shape)
    if merge:
        _merge_fixed_joints(builder, start, text)
    return rows


def _merge_fixed_joints(builder: newton.ModelBuilder, start: BuilderStart, text: str) -> None:
    """Merge the bodies that fixed joints of an imported file connect.

    Those of other files stay, the root's own joint, and joints with ``dont_collapse="true"``, as Isaac Sim's importer
    has it: feet and hands that a task names are often such bodies.
    """
    kept = {
        joint.get("name")
        for joint in ElementTree.fromstring(text).iter("joint")
        if joint.get("dont_collapse") == "true"
    }
    joints = range(builder.joint_count)
    builder.collapse_fixed_joints(
        joints_to_keep=[
            j
            for j in joints
            if j < start.joint or builder.joint_parent[j] < 0 or builder.joint_label[j].rpartition("/")[2] in kept
        ]
    )


def _set_gains(
    builder: newton.ModelBuilder,
    start: BuilderStart,
    stiffness: float | dict[str, float] | None,
    damping: float | dict[str, float] | None,
) -> None:
    """Give the drives of an imported file's hinges and sliders gains, where there are any."""
    driven = (newton.JointType.REVOLUTE, newton.JointType.PRISMATIC)
    joints = [j for j in range(start.joint, builder.joint_count) if builder.joint_type[j] in driven]
    names, dofs = (
        [builder.joint_label[j].rpartition("/")[2] for j in joints],
        [builder.joint_qd_start[j] for j in joints],
    )
    for array, values in ((builder.joint_target_ke, stiffness), (builder.joint_target_kd, damping)):
        for i, value in match_values(values, names, what="joint").items() if values is not None else ():
            array[dofs[i]] = value
            builder.joint_target_mode[dofs[i]] = int(
                newton.JointTargetMode.from_gains(
                    builder.joint_target_ke[dofs[i]], builder.joint_target_kd[dofs[i]], has_drive=True
                )
            )


def _round_cylinders(builder: newton.ModelBuilder, first: int) -> None:
    """Make capsules of the cylinders that collide; the scale of both is radius and half of the length."""
    for shape in range(first, builder.shape_count):
        if builder.shape_type[shape] == GeoType.CYLINDER and builder.shape_flags[shape] & ShapeFlags.COLLIDE_SHAPES:
            builder.shape_type[shape] = int(GeoType.CAPSULE)


def _open_empty_ranges(builder: newton.ModelBuilder, first: int) -> None:
    """Give joints whose limits are equal, and drives whose effort is 0, ranges that MuJoCo takes.

    Both are valid in URDF: the joint is locked, and the drive does nothing,
    for which :func:`urdf_rows` has a row.
    """
    for dof in range(first, builder.joint_dof_count):
        if builder.joint_limit_lower[dof] == builder.joint_limit_upper[dof]:
            builder.joint_limit_lower[dof] -= _SMALLEST_RANGE
            builder.joint_limit_upper[dof] += _SMALLEST_RANGE
        if builder.joint_effort_limit[dof] == 0.0:
            builder.joint_effort_limit[dof] = _SMALLEST_RANGE


def _add_mjcf(
    builder: newton.ModelBuilder, path: Path, options: dict[str, Any], xform: wp.transform | None
) -> list[Row]:
    own, start = dict(options), MjcfStart(builder)
    keyframe = own.pop("keyframe", None)
    contacts = own.pop("condim", None), own.pop("solimp", None)
    source, model = edit_mjcf(path, own.pop("actuators", True), own.pop("fixed_tendons", {}), *contacts)
    if (root_pose := own.pop("root_pose", None)) is not None:
        wanted = (wp.transform_identity() if xform is None else xform) * wp.transform(*root_pose)
        xform = _without_root_pose(model, wanted, own.get("scale", 1.0))
    shapes, friction = builder.default_shape_cfg, builder.default_shape_cfg.mu
    _replace_pgs(builder)
    try:
        # MuJoCo's default friction is 1; Newton's importer would take that of the builder where a file gives none.
        shapes.mu = 1.0
        # verbose: else it skips what it cannot find in silence
        builder.add_mjcf(source, xform=xform, verbose=True, **own)
    finally:
        shapes.mu = friction
    scale = own.get("scale", 1.0)
    anchor_hinges(builder, start.joint, model, scale)  # before coordinates are moved by ref
    rows: list[Row] = []
    if scale == 1.0 and not own.get("collapse_fixed_joints"):
        rows += take_compiled_masses(builder, start.body, model)
    complete_mjcf(builder, str(path), start, keyframe, xform, scale)
    show_drawn_colliders(builder, start.body, start.shape, model)
    if not own.get("collapse_fixed_joints"):
        tie_sites(builder, start.equality, model, scale, xform)
        rows += let_tied_bodies_collide(builder, start.equality, model)
    return [*rows, *mjcf_rows(builder, start, model, options), *joint_motion_rows(builder, start.joint, model, scale)]


def _without_root_pose(model: mujoco.MjModel, wanted: wp.transform, scale: float) -> wp.transform:
    """Pose of the file's world that puts its first body at ``wanted``."""
    w, x, y, z = (float(v) for v in model.body_quat[1])
    root = wp.transform(wp.vec3(*(float(v) * scale for v in model.body_pos[1])), wp.quat(x, y, z, w))
    return wanted * wp.transform_inverse(root)


def _replace_pgs(builder: newton.ModelBuilder) -> None:
    """Replace the PGS solver of MJCF files by Newton's method, as MuJoCo Warp has no PGS."""
    attribute = builder.custom_attributes.get("mujoco:solver")
    if attribute is not None and attribute.mjcf_value_transformer is not None:
        read = attribute.mjcf_value_transformer
        attribute.mjcf_value_transformer = lambda value, context: read("newton" if value == "PGS" else value, context)


def _collide_by_hulls(builder: newton.ModelBuilder, start: BuilderStart) -> None:
    """Let mesh colliders be their hulls for Newton's collision detection too, as they are for MuJoCo's."""
    for shape in range(start.shape, builder.shape_count):
        if builder.shape_type[shape] == GeoType.MESH and builder.shape_flags[shape] & ShapeFlags.COLLIDE_SHAPES:
            builder.shape_type[shape] = GeoType.CONVEX_MESH


def _planes_to_world(builder: newton.ModelBuilder, start: BuilderStart) -> Iterator[Row]:
    """Attach planes to the world: MuJoCo takes them on bodies without joints, Newton's solver on none."""
    for shape in range(start.shape, builder.shape_count):
        body = builder.shape_body[shape]
        if builder.shape_type[shape] != GeoType.PLANE or body < 0:
            continue
        builder.shape_transform[shape] = wp.transform(*builder.body_q[body]) * wp.transform(
            *builder.shape_transform[shape]
        )
        builder.body_shapes[body].remove(shape)
        builder.body_shapes.setdefault(-1, []).append(shape)
        builder.shape_body[shape] = -1
        name = builder.body_label[body].rpartition("/")[2]
        yield builder.shape_label[shape].rpartition("/")[2], "plane", f"of the world, as its body '{name}' stands still"


def _large_shapes(builder: newton.ModelBuilder, start: BuilderStart) -> Iterator[str]:
    for shape in range(start.shape, builder.shape_count):
        if not (extent := shape_extent(builder, shape)) <= MAX_COORDINATE:
            name = builder.shape_label[shape].rpartition("/")[2]
            yield f"shape '{name}': has a size of {extent:g} m; it must be finite and at most {MAX_COORDINATE:g} m"


def _mass_problems(builder: newton.ModelBuilder, start: BuilderStart) -> Iterator[str]:
    for body, problem in mass_problems(builder, start, smallest=MUJOCO_MINIMUM):
        yield f"body '{builder.body_label[body].rpartition('/')[2]}': {problem}"


def _grouped(rows: list[Row]) -> Iterator[Row]:
    """Rows that say the same of several elements as one with their number."""
    places: dict[tuple[str, str], list[str]] = {}
    for where, what, why in rows:
        places.setdefault((what, why), []).append(where)
    for (what, why), found in places.items():
        yield found[0] + (f" (+{len(found) - 1} more)" if len(found) > 1 else ""), what, why


def _prefix_labels(builder: newton.ModelBuilder, start: BuilderStart, label: str) -> None:
    """Put a path before labels: Newton takes the names of a file, and USD assets have paths."""
    if not label:
        return
    for labels, first in (
        (builder.body_label, start.body),
        (builder.joint_label, start.joint),
        (builder.shape_label, start.shape),
        (builder.articulation_label, start.articulation),
    ):
        labels[first:] = [f"{label}/{name}" for name in labels[first:]]
    if builder.articulation_count == start.articulation + 1:
        builder.articulation_label[-1] = label


def _report(builder: newton.ModelBuilder, start: BuilderStart, path: Path, label: str, rows: list[Row]) -> StageReport:
    """The report of a stage, of a file that is none: in metres and kilograms, with Z up."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    return build_report(builder, start, stage, stage, "/", (), rows, str(path), None)
