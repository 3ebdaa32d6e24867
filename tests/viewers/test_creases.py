# SPDX-License-Identifier: Apache-2.0
"""Creases: normals against trimesh's, and what pictures and cameras make of them."""

from __future__ import annotations

import newton
import numpy as np
import trimesh

from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_newton.viewers.creases import corner_normals, creased
from tests.helpers.viewed_scenes import sim_of


def newton_mesh(mesh: trimesh.Trimesh, normals: np.ndarray | None = None) -> newton.Mesh:
    return newton.Mesh(mesh.vertices, mesh.faces.reshape(-1), normals=normals, compute_inertia=False)


def test_edges_of_a_box_stay_sharp():
    box = trimesh.creation.box((1.0, 2.0, 0.3))
    found = corner_normals(box.vertices, box.faces)
    np.testing.assert_allclose(found, np.repeat(box.face_normals[:, None], 3, axis=1), atol=1e-12)
    made = creased(newton_mesh(box, box.vertex_normals))
    assert len(made.vertices) == 24  # three for each corner of the box
    np.testing.assert_allclose(made.normals[made.indices.reshape(-1, 3)[:, 0]], box.face_normals, atol=1e-6)


def test_a_sphere_is_smooth_and_a_cylinder_is_where_it_is_round():
    ball = trimesh.creation.icosphere(3, 0.5)
    apart = ball.copy()
    apart.unmerge_vertices()  # as importers leave faces: three vertices of its own for each
    for mesh in (ball, apart):
        found = corner_normals(mesh.vertices, mesh.faces)
        radial = mesh.vertices[mesh.faces] / 0.5
        assert np.degrees(np.arccos(np.clip((found * radial).sum(axis=-1), -1, 1))).max() < 1.0
    tube = trimesh.creation.cylinder(0.5, 1.0, sections=32)
    found = corner_normals(tube.vertices, tube.faces)
    caps = np.abs(tube.face_normals[:, 2]) > 0.9
    np.testing.assert_allclose(found[caps], np.repeat(tube.face_normals[caps][:, None], 3, axis=1), atol=1e-9)
    side = tube.vertices[tube.faces[~caps]] * [2.0, 2.0, 0.0]
    assert (found[~caps] * side).sum(axis=-1).min() > np.cos(np.radians(0.5))
    # Sixteen sides meet at 22.5 degrees, eight at 45: those are edges.
    coarse = trimesh.creation.cylinder(0.5, 1.0, sections=8)
    found = corner_normals(coarse.vertices, coarse.faces)
    np.testing.assert_allclose(found, np.repeat(coarse.face_normals[:, None], 3, axis=1), atol=1e-9)


def test_authored_normals_and_texture_seams_are_kept():
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    box.unmerge_vertices()
    normals = np.repeat(box.face_normals, 3, axis=0)
    normals[0:3] = [0.0, 0.6, 0.8]  # neither of a face nor one for each place
    authored = newton_mesh(box, normals)
    assert creased(authored) is authored
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    made = creased(newton.Mesh(flat.vertices, flat.faces.reshape(-1), uvs=uvs, compute_inertia=False))
    np.testing.assert_array_equal(np.asarray(made.uvs), np.asarray(made.vertices)[:, :2])


def test_huge_meshes_are_drawn_as_they_are(monkeypatch):
    mesh = newton_mesh(trimesh.creation.box((1.0, 1.0, 1.0)))
    monkeypatch.setattr("stripe_newton.viewers.creases._MOST_FACES", 11)
    assert creased(mesh) is mesh


def test_a_box_of_triangles_looks_as_a_box():
    """Importers give meshes with the default subdivision one normal a vertex, which makes a box look inflated."""
    mesh = trimesh.creation.box((0.3, 0.3, 0.3))

    def picture(add):
        template = newton.ModelBuilder()
        add(template, template.add_body(mass=1.0, inertia=np.eye(3)))
        view = ViewerCfg(eye=(1.0, -0.7, 0.6), lookat=(0.0, 0.0, 0.0), resolution=(96, 64), shadows=False)
        return SceneRenderer(sim_of(template, ground=False), view).render().astype(int)

    inflated = newton_mesh(mesh, mesh.vertex_normals)
    one = picture(lambda t, body: t.add_shape_mesh(body, mesh=inflated, color=(0.8, 0.4, 0.2)))
    two = picture(lambda t, body: t.add_shape_box(body, hx=0.15, hy=0.15, hz=0.15, color=(0.8, 0.4, 0.2)))
    assert (np.abs(one - two).max(axis=-1) <= 1).mean() > 0.995
    assert len(np.asarray(inflated.vertices)) == 8  # the simulation's own mesh is as it was
