# SPDX-License-Identifier: Apache-2.0
"""Collider mesh: the static colliders of a builder as one triangle mesh in the world frame."""

from __future__ import annotations

from collections.abc import Iterable

import newton
import numpy as np
import warp as wp
from newton import GeoType
from scipy.spatial.transform import Rotation

__all__ = ["collider_mesh", "start_poses", "static_colliders", "triangles_of"]

_ENDLESS = 1000.0
"""Half the extent that a plane without a width or a length gets [m]."""
_PLAIN = {"compute_normals": False, "compute_uvs": False, "compute_inertia": False}


def start_poses(builder: newton.ModelBuilder) -> np.ndarray:
    """Poses of the bodies where the initial positions of their joints put them [m], ``(bodies, 7)``."""
    if not builder.body_count:
        return np.zeros((0, 7))
    model = builder.finalize(device="cpu")
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
    """Triangles of shapes in the world frame; curved shapes have 32 facets around.

    Args:
        builder: The builder.
        shapes: Its shapes.
        body_poses: Poses of its bodies [m], ``(bodies, 7)``; None if none of the shapes belongs to one.

    Returns:
        Points [m], ``(points, 3)``, and faces, indices of three points, ``(faces, 3)``.
    """
    points, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=int)], 0
    for shape in shapes:
        mesh, factor = _mesh_of(builder, shape)
        own = np.asarray(mesh.vertices, dtype=float) * factor
        poses, body = [np.array(builder.shape_transform[shape], dtype=float)], builder.shape_body[shape]
        if body >= 0 and body_poses is not None:
            poses.append(body_poses[body])
        for pose in poses:
            own = Rotation.from_quat(pose[3:]).apply(own) + pose[:3]
        points.append(own)
        turned = np.asarray(mesh.indices, dtype=int).reshape(-1, 3)
        # A mirror turns triangles inside out.
        faces.append((turned[:, ::-1] if np.prod(np.sign(factor)) < 0.0 else turned) + count)
        count += len(own)
    return np.concatenate(points), np.concatenate(faces)


def _mesh_of(builder: newton.ModelBuilder, shape: int) -> tuple[newton.Mesh, np.ndarray]:
    """Mesh of a shape in its frame, and the factors on its coordinates.

    Raises:
        ValueError: for a kind of shape that has no mesh.
    """
    kind, source = GeoType(builder.shape_type[shape]), builder.shape_source[shape]
    a, b, c = (float(s) for s in builder.shape_scale[shape])
    one, along_z = np.ones(3), newton.Axis.Z
    if kind in (GeoType.MESH, GeoType.CONVEX_MESH):
        return source, np.array((a, b, c))
    if kind == GeoType.HFIELD:
        return _field_mesh(source), np.array((a, b, c))
    if kind == GeoType.PLANE:
        return newton.Mesh.create_plane(a or 2.0 * _ENDLESS, b or 2.0 * _ENDLESS, **_PLAIN), one
    if kind == GeoType.BOX:
        return newton.Mesh.create_box(a, b, c, **_PLAIN), one
    if kind == GeoType.SPHERE:
        return newton.Mesh.create_sphere(a, **_PLAIN), one
    if kind == GeoType.ELLIPSOID:
        return newton.Mesh.create_sphere(1.0, **_PLAIN), np.array((a, b, c))
    if kind == GeoType.CAPSULE:
        return newton.Mesh.create_capsule(a, b, up_axis=along_z, **_PLAIN), one
    if kind == GeoType.CYLINDER:
        return newton.Mesh.create_cylinder(a, b, up_axis=along_z, **_PLAIN), one
    if kind == GeoType.CONE:
        return newton.Mesh.create_cone(a, b, up_axis=along_z, **_PLAIN), one
    raise ValueError(f"'{builder.shape_label[shape]}': is a {kind.name}, which has no triangles")


def _field_mesh(field: newton.Heightfield) -> newton.Mesh:
    """The surface of a height field; cells are cut from (row + 1, column) to (row, column + 1), as for contacts."""
    heights = field.min_z + np.asarray(field.data, dtype=float) * (field.max_z - field.min_z)
    nrow, ncol = heights.shape
    x, y = np.meshgrid(np.linspace(-field.hx, field.hx, ncol), np.linspace(-field.hy, field.hy, nrow))
    first = (np.arange(nrow - 1)[:, None] * ncol + np.arange(ncol - 1)).reshape(-1)
    faces = np.stack([first, first + 1, first + ncol, first + 1, first + ncol + 1, first + ncol], axis=1)
    points = np.stack([x, y, heights], axis=-1).reshape(-1, 3).astype(np.float32)
    return newton.Mesh(points, faces.reshape(-1).astype(np.int32), compute_inertia=False)
