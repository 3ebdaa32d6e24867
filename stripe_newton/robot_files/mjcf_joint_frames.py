# SPDX-License-Identifier: Apache-2.0
"""MJCF joint frames: hinges turn about the anchors of the file, and what cannot has a row."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import newton
import numpy as np
import warp as wp
from newton import JointType

from .mjcf_masses import bodies_of_file
from .urdf_checks import Row

__all__ = ["anchor_hinges", "joint_motion_rows"]

_SAMPLES = 3
_ADVICE = "hinges of one body with several anchors, or a slide after a hinge, are no joint of Newton"


def anchor_hinges(builder: newton.ModelBuilder, first_joint: int, model: mujoco.MjModel, scale: float) -> None:
    """Put the anchor of merged joints where their hinges have it.

    Newton merges the joints of a body into one and takes the ``pos`` of the first, which in MuJoCo means nothing for
    a slide: the hinge after it would turn about another point.

    Args:
        builder: The builder that the file was added to.
        first_joint: Number of joints before.
        model: MuJoCo's model of the file.
        scale: Scale of lengths.
    """
    for joint, own in _matched(builder, first_joint, model):
        hinges = [j for j in own if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
        if len(own) < 2 or not hinges:
            continue
        child = wp.transform(*builder.joint_X_c[joint])
        # The pose of the body in its parent, which stays.
        body = wp.transform(*builder.joint_X_p[joint]) * wp.transform_inverse(child)
        moved = wp.transform(wp.vec3(*(model.jnt_pos[hinges[0]] * scale)), child.q)
        builder.joint_X_c[joint], builder.joint_X_p[joint] = moved, body * moved


def joint_motion_rows(
    builder: newton.ModelBuilder, first_joint: int, model: mujoco.MjModel, scale: float
) -> Iterator[Row]:
    """Rows of joints that move their body otherwise than MuJoCo's, by the poses at a few random coordinates."""
    random, worst = np.random.default_rng(0), dict[int, tuple[float, float]]()
    data = mujoco.MjData(model)
    matched = _matched(builder, first_joint, model)
    for _ in range(_SAMPLES):
        data.qpos[:] = model.qpos0
        for _, own in matched:
            for j in own:
                data.qpos[model.jnt_qposadr[j]] += random.uniform(-0.7, 0.7)
        mujoco.mj_kinematics(model, data)
        for joint, own in matched:
            expected = _relative_pose(model, data, int(model.jnt_bodyid[own[0]]), scale)
            found = _joint_pose(
                builder, joint, data.qpos[model.jnt_qposadr[own]], [_factor(model, j, scale) for j in own]
            )
            difference = wp.transform_inverse(found) * expected
            metres = float(wp.length(wp.transform_get_translation(found) - wp.transform_get_translation(expected)))
            angle = 2.0 * float(np.arccos(min(1.0, abs(float(wp.transform_get_rotation(difference)[3])))))
            old = worst.get(joint, (0.0, 0.0))
            worst[joint] = (max(old[0], metres), max(old[1], angle))
    for joint, (metres, angle) in worst.items():
        if metres > 1e-4 or angle > 2e-3:
            name = builder.joint_label[joint].rpartition("/")[2]
            far = f"{metres:.3g} m and {np.degrees(angle):.3g} degrees"
            yield name, "motion", f"MuJoCo moves its body otherwise, by up to {far} within 40 degrees: {_ADVICE}"


def _factor(model: mujoco.MjModel, joint: int, scale: float) -> float:
    return scale if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else 1.0


def _matched(builder: newton.ModelBuilder, first_joint: int, model: mujoco.MjModel) -> list[tuple[int, list[int]]]:
    """Joints of the builder with hinges and slides, each with those of its body in the file, slides first."""
    first_body = min((builder.joint_child[j] for j in range(first_joint, builder.joint_count)), default=0)
    bodies, found = bodies_of_file(builder, first_body, model), []
    for joint in range(first_joint, builder.joint_count):
        there = bodies.get(builder.joint_child[joint], -1)
        if builder.joint_type[joint] not in (JointType.REVOLUTE, JointType.PRISMATIC, JointType.D6) or there < 0:
            continue
        start = int(model.body_jntadr[there])
        own = sorted(
            range(start, start + int(model.body_jntnum[there])),
            key=lambda j: int(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE),
        )
        if own and len(own) == sum(builder.joint_dof_dim[joint]):
            found.append((joint, own))
    return found


def _relative_pose(model: mujoco.MjModel, data: mujoco.MjData, body: int, scale: float) -> wp.transform:
    """Pose of a body in its parent's frame."""
    poses = []
    for b in (int(model.body_parentid[body]), body):
        w, x, y, z = data.xquat[b]
        poses.append(wp.transform(wp.vec3(*(data.xpos[b] * scale)), wp.quat(x, y, z, w)))
    return wp.transform_inverse(poses[0]) * poses[1]


def _joint_pose(builder: newton.ModelBuilder, joint: int, values: np.ndarray, factors: list[float]) -> wp.transform:
    """Pose of a joint's child in its parent's frame at some coordinates."""
    linear, angular = builder.joint_dof_dim[joint]
    start = builder.joint_qd_start[joint]
    shift, turn = wp.vec3(), wp.quat_identity()
    for k in range(linear + angular):
        axis, value = wp.vec3(*builder.joint_axis[start + k]), float(values[k]) * factors[k]
        if k < linear:
            shift += axis * value
        else:
            turn = turn * wp.quat_from_axis_angle(axis, value)
    frame = wp.transform(*builder.joint_X_p[joint]) * wp.transform(shift, turn)
    return frame * wp.transform_inverse(wp.transform(*builder.joint_X_c[joint]))
