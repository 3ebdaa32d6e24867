# SPDX-License-Identifier: Apache-2.0
"""Foliage and ground as files for a browser: what trimesh reads from them."""

from __future__ import annotations

import io

import newton
import numpy as np
import pytest
import trimesh

from stripe_newton.viewers.leaf_meshes import LEAF_STYLES
from stripe_newton.viewers.live.scenery_files import foliage_file, ground_file, leaf_tile


def read(data):
    """The only mesh of a GLB file."""
    (mesh,) = trimesh.load(io.BytesIO(data), file_type="glb", process=False).geometry.values()
    return mesh


@pytest.fixture
def crown():
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=1.5)
    mesh = newton.Mesh(sphere.vertices.astype(np.float32), sphere.faces.reshape(-1), compute_inertia=False)
    mesh.foliage = "leaves"
    return mesh


def test_leaves_are_a_texture_with_holes_on_triangles_that_face_outwards(crown):
    mesh = read(foliage_file(crown, np.array([0.2, 0.3, 0.1])))
    assert mesh.faces.shape == (320, 3)
    assert mesh.vertices.shape == (3 * 320, 3)
    material = mesh.visual.material
    assert material.alphaMode == "MASK"
    assert material.doubleSided
    assert np.asarray(material.baseColorTexture).shape == (256, 256, 4)
    # trimesh computes the normals of the faces from their corners.
    assert ((mesh.face_normals * mesh.triangles_center).sum(axis=1) > 0.9).all()
    assert ((mesh.vertex_normals * mesh.vertices).sum(axis=1) > 0.9).all()
    margin = LEAF_STYLES["leaves"]["margin"]
    assert mesh.area > 1.1 * trimesh.creation.icosphere(subdivisions=2, radius=1.5).area
    assert np.abs(mesh.vertices).max() < 1.5 + 3.0 * margin


def test_leaves_have_their_size_whatever_the_size_of_their_triangles(crown):
    """Neighbours in a triangle are as far apart in the tile as in metres."""
    mesh = read(foliage_file(crown, np.ones(3)))
    style = LEAF_STYLES["leaves"]
    tile = 8 * np.array([0.6 * style["length"], 0.95 * style["width"]])
    for ends in ((0, 1), (1, 2)):
        flat = (mesh.visual.uv[ends[0] :: 3] - mesh.visual.uv[ends[1] :: 3]) * tile
        apart = np.linalg.norm(mesh.vertices[ends[0] :: 3] - mesh.vertices[ends[1] :: 3], axis=1)
        np.testing.assert_allclose(np.linalg.norm(flat, axis=1), apart, rtol=1e-4)


@pytest.mark.parametrize("name", [name for name in LEAF_STYLES if name])
def test_a_tile_covers_enough_to_be_seen_from_afar_and_repeats(name):
    tile = leaf_tile(name)
    covered = (tile[..., 3] > 127).mean()
    assert 0.4 < covered < 0.9  # half of it is where browsers begin to leave out small copies
    edge = (tile[0, :, 3] != tile[-1, :, 3]).mean()  # a seam would cut most of the leaves on it
    inner = np.mean([(tile[i, :, 3] != tile[i + 1, :, 3]).mean() for i in range(255)])
    assert edge < 3.0 * inner + 0.05


def test_the_ground_has_its_colours_where_they_are():
    """The half with larger x is green, the other one red; the picture is seen from above."""
    field = newton.Heightfield(np.zeros((5, 9), np.float32), nrow=5, ncol=9, hx=4.0, hy=2.0)
    field.colors = np.full((5, 9, 3), (0.3, 0.01, 0.01), np.float32)
    field.colors[:, 5:] = 0.01, 0.3, 0.01
    x, y = np.meshgrid(np.linspace(-4.0, 4.0, 9), np.linspace(-2.0, 2.0, 5))
    grid = trimesh.creation.box()  # any faces: places and colours count
    vertices = np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3)[: len(grid.vertices)]
    pose = np.array([1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    mesh = read(ground_file(field, pose, vertices, grid.faces))
    picture = np.asarray(mesh.visual.material.baseColorTexture).astype(int)
    assert picture.shape == (200, 400, 3)
    # trimesh has v upwards, files downwards.
    at = np.round(mesh.visual.uv * (399, 199)).astype(int)
    red, green = picture[199 - at[:, 1], at[:, 0], 0], picture[199 - at[:, 1], at[:, 0], 1]
    assert ((green > red) == (mesh.vertices[:, 0] > 0.5)).all()
