# SPDX-License-Identifier: Apache-2.0
"""Builder checks: reasons to refuse a stage that show only after Newton has read it."""

from __future__ import annotations

import newton
import numpy as np
from newton import GeoType, JointType

from .attribute_table import MAX_COORDINATE
from .body_masses import MUJOCO_MINIMUM, mass_problems
from .builder_start import BuilderStart
from .stage_access import StageError

__all__ = ["check_builder", "shape_extent"]

_MUJOCO_JOINTS = {
    JointType.FREE,
    JointType.FIXED,
    JointType.REVOLUTE,
    JointType.PRISMATIC,
    JointType.BALL,
    JointType.D6,
}


def check_builder(builder: newton.ModelBuilder, start: BuilderStart, solver: str, name: str) -> None:
    """Refuse problems that show only after Newton has read the stage.

    Raises:
        StageError: a body without mass, a body without a joint, a joint that the solver does not support, a value that
            is not finite, a plane on a moving body.
    """
    for shape in range(start.shape, builder.shape_count):
        if not shape_extent(builder, shape) <= MAX_COORDINATE:
            reason = (
                f"has a size of {shape_extent(builder, shape):g} m; it must be finite and at most {MAX_COORDINATE:g} m"
            )
            raise StageError(name, builder.shape_label[shape], f"{reason}: are size, scale and units right?")
    _check_bodies(builder, start, solver, name)
    _check_joints(builder, start, solver, name)
    for shape in range(start.shape, builder.shape_count):
        if builder.shape_type[shape] == GeoType.PLANE and builder.shape_body[shape] >= 0 and solver == "mujoco":
            reason = "is a plane on a rigid body, which MuJoCo does not take; use a box, or take it off the body"
            raise StageError(name, builder.shape_label[shape], reason)


def shape_extent(builder: newton.ModelBuilder, shape: int) -> float:
    """Largest coordinate of a shape in its body's frame [m]; not-a-number or infinite for one beyond float32."""
    scale = np.abs(np.array(builder.shape_scale[shape], dtype=float))
    vertices = getattr(builder.shape_source[shape], "vertices", None)
    if vertices is not None and len(vertices):
        scale = scale * np.abs(np.asarray(vertices, dtype=float)).max(axis=0)
    return float(np.max([*scale, *np.abs(np.array(builder.shape_transform[shape], dtype=float))[:3]]))


def _check_bodies(builder: newton.ModelBuilder, start: BuilderStart, solver: str, name: str) -> None:
    articulated = {
        builder.joint_child[j] for j in range(start.joint, builder.joint_count) if builder.joint_articulation[j] >= 0
    }
    for body, problem in mass_problems(builder, start, smallest=MUJOCO_MINIMUM if solver == "mujoco" else 0.0):
        raise StageError(name, builder.body_label[body], problem)
    for body in range(start.body, builder.body_count):
        label = builder.body_label[body]
        if body not in articulated:
            reason = "hangs on a joint outside every articulation; apply PhysicsArticulationRootAPI above both"
            raise StageError(name, label, reason)
        if not np.isfinite(np.array(builder.body_q[body])).all():
            raise StageError(name, label, "its pose is not finite")


def _check_joints(builder: newton.ModelBuilder, start: BuilderStart, solver: str, name: str) -> None:
    for joint in range(start.joint, builder.joint_count):
        kind = JointType(builder.joint_type[joint])
        if solver == "mujoco" and kind not in _MUJOCO_JOINTS:
            reason = (
                f"is a {kind.name} joint, which the MuJoCo solver does not take; use another joint, or another solver"
            )
            raise StageError(name, builder.joint_label[joint], reason)
        frames = [*builder.joint_X_p[joint], *builder.joint_X_c[joint]]
        if not np.isfinite(np.array(frames, dtype=float)).all():
            raise StageError(name, builder.joint_label[joint], "its local frames are not finite")
    if not np.isfinite(np.array(builder.joint_q[start.coord :], dtype=float)).all():
        raise StageError(name, "", "an initial joint position is not finite")
