# SPDX-License-Identifier: Apache-2.0
"""Collider mesh: the static colliders of a builder as one triangle mesh in the world frame."""

from __future__ import annotations

from collections.abc import Iterable

import newton
import numpy as np
import warp as wp

from stripe_newton.collision_tables import finalize_without_tables
from stripe_newton.shape_mesh import shape_mesh

__all__ = ["collider_mesh", "start_poses", "static_colliders", "triangles_of"]


def start_poses(builder: newton.ModelBuilder) -> np.ndarray:
    """Poses of the bodies where the initial positions of their joints put them [m], ``(bodies, 7)``."""
    if not builder.body_count:
        return np.zeros((0, 7))
    model = finalize_without_tables(builder, "cpu")
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    return np.asarray(state.body_q.numpy(), dtype=float)


def static_colliders(builder: newton.ModelBuilder, first: int = 0) -> list[int]:
    """Shapes from ``first`` on that collide and belong to no body."""
    solid = int(newton.ShapeFlags.COLLIDE_SHAPES)
    return [
        i
        for i in range(first, builder.shape_count)
        if builder.shape_body[i] < 0 and int(builder.shape_flags[i]) & solid
    ]


def collider_mesh(points: np.ndarray, faces: np.ndarray, device: str) -> wp.Mesh:
    """Triangles as a mesh for rays and winding numbers.

    Args:
        points: Points [m], shape ``(points, 3)``.
        faces: Indices of three points, shape ``(faces, 3)``, at least one.
        device: Device of the mesh.
    """
    with wp.ScopedDevice(device):
        return wp.Mesh(
            wp.array(points.astype(np.float32), dtype=wp.vec3),
            wp.array(faces.reshape(-1).astype(np.int32), dtype=int),
            support_winding_number=True,
        )


def triangles_of(
    builder: newton.ModelBuilder, shapes: Iterable[int], body_poses: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of shapes in the world frame.

    Args:
        builder: The builder.
        shapes: Its shapes.
        body_poses: Poses of its bodies [m], ``(bodies, 7)``; None if none of the shapes belongs to one.

    Returns:
        Points [m], ``(points, 3)``, and faces, indices of three points, ``(faces, 3)``.
    """
    from scipy.spatial.transform import Rotation  # here, as it takes long to import

    points, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=int)], 0
    for shape in shapes:
        own, own_faces = shape_mesh(
            builder.shape_type[shape],
            builder.shape_scale[shape],
            builder.shape_source[shape],
            builder.shape_label[shape],
        )
        poses, body = [np.array(builder.shape_transform[shape], dtype=float)], builder.shape_body[shape]
        if body >= 0 and body_poses is not None:
            poses.append(body_poses[body])
        for pose in poses:
            own = Rotation.from_quat(pose[3:]).apply(own) + pose[:3]
        points.append(own)
        faces.append(own_faces + count)
        count += len(own)
    return np.concatenate(points), np.concatenate(faces)
