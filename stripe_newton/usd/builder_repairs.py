# SPDX-License-Identifier: Apache-2.0
"""Builder repairs: what Newton has read is completed where ``finalize`` or the MuJoCo solver would refuse it."""

from __future__ import annotations

import newton
import numpy as np
from newton import GeoType, JointType
from pxr import Usd

from .ignored_rows import Ignored
from .mesh_copies import with_geometry
from .stage_access import labelled_prim

__all__ = ["articulate_single_joints", "open_empty_drives", "set_translation_states", "unmirror_meshes"]

_SMALLEST_EFFORT = 1.0e-5
"""Limit of a drive whose ``maxForce`` is 0 [N or N m]."""


def unmirror_meshes(builder: newton.ModelBuilder, first: int) -> None:
    """Bake negative scales of meshes into their vertices, as the MuJoCo solver refuses them."""
    for shape in range(first, builder.shape_count):
        scale = np.array(builder.shape_scale[shape], dtype=np.float32)
        mesh = builder.shape_source[shape]
        if builder.shape_type[shape] not in (GeoType.MESH, GeoType.CONVEX_MESH) or (scale >= 0.0).all():
            continue
        faces = np.array(mesh.indices, dtype=np.int32).reshape(-1, 3)
        if np.prod(np.sign(scale)) < 0.0:  # a mirror turns faces inside out, two mirrors are a rotation
            faces = faces[:, ::-1]
        # A new mesh: the old one may be shared with shapes that are not mirrored.
        mirrored = with_geometry(
            mesh,
            np.array(mesh.vertices) * np.sign(scale),
            faces.reshape(-1).copy(),
            normals=None if mesh.normals is None else np.array(mesh.normals) * np.sign(scale),
            uvs=mesh.uvs,
        )
        builder.shape_source[shape] = mirrored
        builder.shape_scale[shape] = tuple(float(s) for s in np.abs(scale))


def articulate_single_joints(builder: newton.ModelBuilder, first: int, rows: Ignored) -> None:
    """Make an articulation of each body that one joint connects to the world.

    OpenUSD's parser reports such an articulation without its body. Newton then leaves the joint out of every
    articulation, and its forward kinematics would skip it.
    """
    children = {builder.joint_child[j] for j in range(first, builder.joint_count) if builder.joint_articulation[j] >= 0}
    for joint in range(first, builder.joint_count):
        child = builder.joint_child[joint]
        if builder.joint_articulation[joint] < 0 and builder.joint_parent[joint] == -1 and child not in children:
            children.add(child)
            builder.add_articulation([joint], label=builder.joint_label[joint])
            rows.append((builder.joint_label[joint], "joint without articulation", "made an articulation of one body"))
    _sort_articulations(builder)


def _sort_articulations(builder: newton.ModelBuilder) -> None:
    """Sort articulations by their joints, as ``finalize`` demands."""
    order = sorted(range(builder.articulation_count), key=lambda a: builder.articulation_start[a])
    if order == list(range(len(order))):
        return
    for name in ("articulation_start", "articulation_end", "articulation_label", "articulation_world"):
        values = getattr(builder, name)
        values[:] = [values[a] for a in order]
    # What refers to articulations by index: joints, and custom attributes of articulations.
    new = {old: index for index, old in enumerate(order)}
    for joint, articulation in enumerate(list(builder.joint_articulation)):
        builder.joint_articulation[joint] = new.get(articulation, articulation)
    for attribute in builder.custom_attributes.values():
        if attribute.frequency == newton.Model.AttributeFrequency.ARTICULATION and isinstance(attribute.values, dict):
            attribute.values = {new[a]: value for a, value in attribute.values.items()}


def open_empty_drives(builder: newton.ModelBuilder, first: int) -> None:
    """Give drives whose ``maxForce`` is 0 next to none: MuJoCo takes no empty range.

    Args:
        builder: The builder.
        first: First degree of freedom.
    """
    for dof in range(first, builder.joint_dof_count):
        builder.joint_effort_limit[dof] = max(builder.joint_effort_limit[dof], _SMALLEST_EFFORT)


def set_translation_states(builder: newton.ModelBuilder, first: int, stage: Usd.Stage) -> None:
    """Set positions and velocities of the translations of D6 joints, of which Newton reads those of rotations alone.

    Args:
        builder: The builder.
        first: First joint.
        stage: The stage that was read, in SI units.
    """
    for joint in range(first, builder.joint_count):
        linear, _ = builder.joint_dof_dim[joint]
        prim = labelled_prim(stage, builder.joint_label[joint])
        if builder.joint_type[joint] != JointType.D6 or not prim or prim.GetTypeName() != "PhysicsJoint":
            continue
        dof, coord = builder.joint_qd_start[joint], builder.joint_q_start[joint]
        for k in range(linear):
            axis = "XYZ"[int(np.abs(np.array(builder.joint_axis[dof + k], dtype=float)).argmax())]
            for name, values, at in (("position", builder.joint_q, coord + k), ("velocity", builder.joint_qd, dof + k)):
                attribute = prim.GetAttribute(f"state:trans{axis}:physics:{name}")
                if attribute and attribute.Get() is not None:
                    values[at] = float(attribute.Get())
