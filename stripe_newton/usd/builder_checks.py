# SPDX-License-Identifier: Apache-2.0
"""Builder checks: reasons to refuse a stage that show only after Newton has read it."""

from __future__ import annotations

import math

import newton
import numpy as np
from newton import GeoType, JointType

from .attribute_table import MAX_COORDINATE
from .stage_access import StageError

__all__ = ["BuilderStart", "check_builder", "group_masses", "shape_extent"]

_MUJOCO_JOINTS = {
    JointType.FREE,
    JointType.FIXED,
    JointType.REVOLUTE,
    JointType.PRISMATIC,
    JointType.BALL,
    JointType.D6,
}


_MUJOCO_MINIMUM = 1.0e-15
"""Least mass and moment of inertia of a moving body in MuJoCo, ``mjMINVAL``."""


class BuilderStart:
    """Counts of a builder before a stage is read into it: what comes after them belongs to the stage."""

    def __init__(self, builder: newton.ModelBuilder):
        self.body, self.joint, self.shape = builder.body_count, builder.joint_count, builder.shape_count
        self.dof, self.coord = builder.joint_dof_count, builder.joint_coord_count
        self.articulation = builder.articulation_count


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
    _check_bodies(builder, start, name)
    if solver == "mujoco":
        _check_small_bodies(builder, start, name)
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


def _check_bodies(builder: newton.ModelBuilder, start: BuilderStart, name: str) -> None:
    articulated = {
        builder.joint_child[j] for j in range(start.joint, builder.joint_count) if builder.joint_articulation[j] >= 0
    }
    group_mass = group_masses(builder, start)
    for body in range(start.body, builder.body_count):
        label = builder.body_label[body]
        mass, inertia = builder.body_mass[body], np.array(builder.body_inertia[body], dtype=float).reshape(3, 3)
        if mass < 0.0 or not math.isfinite(mass):
            raise StageError(name, label, f"has mass {mass:g}; it must be positive and finite")
        # A body without mass is fine if it is welded to one that has some, as a sensor's frame is.
        if not group_mass[body] > 0.0:
            raise StageError(name, label, "has no mass: author physics:mass, or give it a collider with a density")
        if mass and (not np.isfinite(inertia).all() or np.linalg.eigvalsh((inertia + inertia.T) / 2).min() <= 0.0):
            raise StageError(name, label, f"its inertia is not positive: {np.diag(inertia)}; author diagonalInertia")
        if body not in articulated:
            reason = "hangs on a joint outside every articulation; apply PhysicsArticulationRootAPI above both"
            raise StageError(name, label, reason)
        if not np.isfinite(np.array(builder.body_q[body])).all():
            raise StageError(name, label, "its pose is not finite")


def _check_small_bodies(builder: newton.ModelBuilder, start: BuilderStart, name: str) -> None:
    for body in range(start.body, builder.body_count):
        mass, inertia = builder.body_mass[body], np.array(builder.body_inertia[body], dtype=float).reshape(3, 3)
        least = min(mass, float(np.linalg.eigvalsh((inertia + inertia.T) / 2).min()))
        if mass > 0.0 and least < _MUJOCO_MINIMUM:
            reason = (
                f"has mass {mass:g} kg and a moment of inertia of {least:g} kg m^2; MuJoCo takes {_MUJOCO_MINIMUM:g}"
            )
            raise StageError(name, builder.body_label[body], f"{reason} or more: are the units right?")


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


def group_masses(builder: newton.ModelBuilder, start: BuilderStart) -> dict[int, float]:
    """Mass of each body with everything that is welded to it; infinite where that is the world."""
    # Union-find over the fixed joints; -1 is the world.
    group = {body: body for body in range(-1, builder.body_count)}

    def top(body: int) -> int:
        while group[body] != body:
            body = group[body]
        return body

    for joint in range(start.joint, builder.joint_count):
        if builder.joint_type[joint] == JointType.FIXED and builder.joint_articulation[joint] >= 0:
            group[top(builder.joint_child[joint])] = top(builder.joint_parent[joint])
    masses = dict.fromkeys(group, 0.0)
    masses[top(-1)] = math.inf
    for body in range(start.body, builder.body_count):
        masses[top(body)] += builder.body_mass[body]
    return {body: masses[top(body)] for body in group}
