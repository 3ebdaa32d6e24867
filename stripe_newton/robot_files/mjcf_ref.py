# SPDX-License-Identifier: Apache-2.0
"""MJCF ``ref``: joint coordinates that count as the file counts them, not from the pose that it shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverMuJoCo

__all__ = ["count_as_the_file"]

_UNLIMITED = 1e9
"""Newton writes 1e10 for a limit that is not there."""
_MIMIC = 2
"""Kind of an equality constraint that Newton keeps as a mimic constraint beside MuJoCo's row."""


def count_as_the_file(builder: newton.ModelBuilder, first_joint: int, first_equality: int) -> None:
    """Move the origins of joint coordinates to where the file has them.

    ``ref`` is the coordinate of a joint in the pose that the file shows. Newton counts from that pose: its coordinates
    are those of MuJoCo less ``ref``, and so are limits, targets and keyframes. Here the joint's frames are changed
    instead, so that position, limits, spring and target are the numbers of the file. The mechanism stays the same.

    Equality constraints are relative to that pose, too: their coefficients and their poses are written out. The
    anchors of ``connect`` are left to :class:`stripe_newton.sim.connect_anchors.ConnectAnchors`.

    Args:
        builder: The builder that the file was added to.
        first_joint: Number of joints before the file was added.
        first_equality: Number of MuJoCo's equality constraints before the file was added.

    Raises:
        ValueError: three hinges share a body, and ``ref`` of the second would make their axes oblique, which
            Newton's joints cannot be; or a weld to the world without ``relpose``.
    """
    attribute = builder.custom_attributes.get("mujoco:dof_ref")
    if attribute is None or not isinstance(attribute.values, dict):
        return
    refs: dict[int, float] = {}
    for joint in range(first_joint, builder.joint_count):
        start, count = builder.joint_qd_start[joint], sum(builder.joint_dof_dim[joint])
        own = [float(attribute.values.pop(start + k, 0.0)) for k in range(count)]
        if any(own) and builder.joint_type[joint] not in (newton.JointType.FREE, newton.JointType.BALL):
            _move_frames(builder, joint, own)
            _move_values(builder, joint, own)
            refs.update((start + k, ref) for k, ref in enumerate(own))
    if refs:
        _move_equalities(builder, refs, first_equality)


def _move_frames(builder: newton.ModelBuilder, joint: int, refs: Sequence[float]) -> None:
    """Turn and shift the frames of a joint so that its coordinates ``refs`` give the pose that 0 gave."""
    linear, angular = builder.joint_dof_dim[joint]
    start = builder.joint_qd_start[joint]
    axes = [np.array(builder.joint_axis[start + k], dtype=float) for k in range(linear + angular)]
    shift = -sum((axes[k] * refs[k] for k in range(linear)), np.zeros(3))
    builder.joint_X_p[joint] = wp.transform(*builder.joint_X_p[joint]) * wp.transform(
        wp.vec3(*shift), wp.quat_identity()
    )
    # A rotation by q - ref is one by q after one by -ref, which turns the axes that follow it.
    turned = wp.quat_identity()
    for k in range(linear, linear + angular):
        axis = wp.vec3(*axes[k])
        builder.joint_axis[start + k] = wp.quat_rotate(turned, axis)
        turned = turned * wp.quat_from_axis_angle(axis, -float(refs[k]))
    child = wp.transform(*builder.joint_X_c[joint])
    builder.joint_X_c[joint] = child * wp.transform(wp.vec3(), wp.quat_inverse(turned))
    hinges = np.array([builder.joint_axis[start + linear + k] for k in range(angular)], dtype=float)
    if angular == 3 and not np.allclose(hinges @ hinges.T, np.eye(3), atol=1e-4):
        degrees = math.degrees(refs[linear + 1])
        raise ValueError(
            f"joint '{builder.joint_label[joint]}': ref={degrees:g} degrees of the second of three hinges on one body "
            "makes their axes oblique, which a joint of Newton cannot have; give each hinge a body of its own, or "
            "leave its ref 0"
        )


def _move_values(builder: newton.ModelBuilder, joint: int, refs: Sequence[float]) -> None:
    """Add ``refs`` to whatever is a coordinate of the joint."""
    dof, coord = builder.joint_qd_start[joint], builder.joint_q_start[joint]
    for k, ref in enumerate(refs):
        for limits in (builder.joint_limit_lower, builder.joint_limit_upper):
            if abs(limits[dof + k]) < _UNLIMITED:
                limits[dof + k] += ref
        for positions in (builder.joint_q, builder.joint_target_q, builder.joint_rest_q):
            positions[coord + k] += ref


def _move_equalities(builder: newton.ModelBuilder, refs: dict[int, float], first: int) -> None:
    kinds = _column(builder, "type")
    for row in range(first, len(kinds)):
        if kinds[row] == SolverMuJoCo.EqType.JOINT:
            _move_joint_equality(builder, refs, row)
        elif kinds[row] == SolverMuJoCo.EqType.WELD:
            _author_weld_pose(builder, row)


def _move_joint_equality(builder: newton.ModelBuilder, refs: dict[int, float], row: int) -> None:
    """Coefficients of ``q1 - ref1 = polynomial(q2 - ref2)`` as a polynomial of q2 itself."""
    one, two = (_endpoint_ref(builder, refs, row, number) for number in (1, 2))
    values = _column(builder, "polycoef")
    polynomial = np.polynomial.Polynomial([float(c) for c in values[row]])
    if _column(builder, "joint2")[row] < 0:  # MuJoCo then takes the constant alone
        coefficients = [polynomial.coef[0] + one, *polynomial.coef[1:]]
    else:
        moved = polynomial(np.polynomial.Polynomial([-two, 1.0])) + one
        coefficients = [*moved.coef, *[0.0] * 5][:5]
    values[row] = [float(c) for c in coefficients]
    if _cell(builder, "target_kind", row, default=0) == _MIMIC:  # the same for solvers other than MuJoCo
        mimic = _column(builder, "target")[row]
        builder.constraint_mimic_coef0[mimic] = float(coefficients[0])
        builder.constraint_mimic_coef1[mimic] = float(coefficients[1])


def _endpoint_ref(builder: newton.ModelBuilder, refs: dict[int, float], row: int, number: int) -> float:
    joint = _column(builder, f"joint{number}")[row]
    if joint < 0:
        return 0.0
    axis = _cell(builder, f"joint{number}_dof", row, default=0)
    return refs.get(builder.joint_qd_start[joint] + max(axis, 0), 0.0)


def _author_weld_pose(builder: newton.ModelBuilder, row: int) -> None:
    """Write out a pose that MuJoCo would take from coordinates 0, which no longer are the pose in the file."""
    poses, anchor = _column(builder, "relpose"), wp.vec3(*_column(builder, "anchor")[row])
    if any(list(poses[row])[3:]):
        return
    one, two = (_column(builder, f"body{number}")[row] for number in (1, 2))
    if one < 0 or two < 0:
        raise ValueError(
            f"weld '{_column(builder, 'label')[row]}' to the world has no relpose, and joints of the file have a ref: "
            "give it a relpose"
        )
    relative = wp.transform_inverse(wp.transform(*builder.body_q[one])) * wp.transform(*builder.body_q[two])
    poses[row] = wp.transform(wp.transform_point(relative, anchor), relative.q)


def _column(builder: newton.ModelBuilder, name: str) -> list[Any]:
    attribute = builder.custom_attributes.get(f"mujoco:equality_constraint_{name}")
    return attribute.values if attribute is not None and isinstance(attribute.values, list) else []


def _cell(builder: newton.ModelBuilder, name: str, row: int, default: int) -> int:
    """A value that a row may leave to the default: the column then is shorter, or has None there."""
    values = _column(builder, name)
    return default if row >= len(values) or values[row] is None else int(values[row])
