# SPDX-License-Identifier: Apache-2.0
"""A step as a mesh, and worlds with a static mesh and a body each at a pose relative to it."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import trimesh
import warp as wp

from stripe_newton.solvers.static_meshes import add_triangles_attribute, mark_triangles

STEP = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
"""Outline of a step, in x and z; it is 1 m wide, in y."""
FRAMES = wp.transform_identity(), wp.transform((3.0, -2.0, 1.0), wp.quat_rpy(0.3, -0.2, 1.0))


def step_mesh(fineness: int = 0, solid: bool = True) -> trimesh.Trimesh:
    """The step as one mesh; open where it is not solid, as its bottom is missing."""
    outline = trimesh.creation.extrude_triangulation(
        STEP, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]), height=1.0
    )
    vertices = outline.vertices[:, [0, 2, 1]]  # the outline stands upright
    mesh = trimesh.Trimesh(vertices, outline.faces[:, ::-1], process=False)
    assert mesh.volume == pytest.approx(3.0)
    if not solid:
        mesh.update_faces(mesh.triangles_center[:, 2] > 1e-6)
    for _ in range(fineness):
        mesh = mesh.subdivide()
    return mesh


def model_of(mesh: object, add_geom: object, poses: np.ndarray, frame: wp.transform) -> newton.Model:
    """Worlds with a static mesh, or what a function adds, and a body each at a pose relative to it; no gravity."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    add_triangles_attribute(builder)
    if isinstance(mesh, trimesh.Trimesh):
        made = newton.Mesh(mesh.vertices, mesh.faces.reshape(-1), compute_inertia=False)
        builder.add_shape_mesh(-1, xform=frame, mesh=made)
    else:
        mesh(builder, frame)
    mark_triangles(builder, 0, set(builder.shape_label))
    body = builder.add_body()
    add_geom(builder, body)
    builder.shape_gap[:] = [0.0] * builder.shape_count
    worlds = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    newton.solvers.SolverMuJoCo.register_custom_attributes(worlds)
    add_triangles_attribute(worlds)
    worlds.replicate(builder, len(poses))
    model = worlds.finalize(device="cpu")
    placed = [wp.transform_multiply(frame, wp.transform(p[:3], wp.quat(*p[3:]))) for p in poses.tolist()]
    model.joint_q.assign(np.array([[*t] for t in placed], dtype=np.float32).reshape(-1))
    return model


def random_poses(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    quat = rng.normal(size=(len(points), 4))
    return np.concatenate([points, quat / np.linalg.norm(quat, axis=1, keepdims=True)], axis=1)
