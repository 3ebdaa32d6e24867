# SPDX-License-Identifier: Apache-2.0
"""Closed meshes, against those that trimesh makes and what trimesh says of them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from stripe_newton.viewers.live.closed_mesh import is_closed

SOLIDS = {
    "box": trimesh.creation.box((4.0, 0.1, 2.5)),
    "ball": trimesh.creation.icosphere(2, 0.3),
    "ring": trimesh.creation.torus(1.0, 0.2),
    "tube": trimesh.creation.annulus(0.4, 0.5, 2.0),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_a_solid_is_closed_until_a_triangle_is_missing_or_turned(name):
    mesh = SOLIDS[name]
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    assert mesh.is_volume
    assert is_closed(vertices, faces)
    assert not is_closed(vertices, faces[1:])
    turned = faces.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(vertices, turned)
    assert not is_closed(vertices, faces[:, ::-1])  # inside out
    assert not is_closed(vertices, np.concatenate((faces, faces)))


def test_corners_at_one_place_are_one():
    """As files have them whose triangles have normals or texture coordinates of their own."""
    mesh = SOLIDS["box"]
    apart = np.array(mesh.vertices)[np.array(mesh.faces).reshape(-1)] + (100.0, -50.0, 3.0)
    assert is_closed(apart, np.arange(len(apart)).reshape(-1, 3))


def test_sheets_and_nothing_are_not_closed():
    sheet = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    assert not is_closed(sheet, np.array([[0, 1, 2], [0, 2, 3]]))
    assert not is_closed(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    assert not is_closed(np.full((4, 3), np.nan), np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
