# SPDX-License-Identifier: Apache-2.0
"""Foliage in pictures: leaves over the edges of its triangles, sky between them, and styles from the stage."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.scene.scenery import read_scenery
from stripe_newton.specifications import MeshPart
from stripe_newton.specifications.scene_pictures import still_life
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_newton.viewers.leaf_meshes import LEAF_STYLES, widened
from stripe_tasks.forest import ForestSpec
from tests.helpers.small_wood import SmallWood

SIZE, HALF = 200, 1.6
"""Side of the picture [px], and half of it [m]."""


def seen_triangle(foliage, device="cpu"):
    """Where a picture shows a triangle of foliage with an inscribed circle of 1 m, and distances to its inside [m]."""
    sim = still_life(SmallWood((4.0, 4.0), count=0).create(0), wp.get_device(device))
    sim.static = newton.ModelBuilder()
    turns = np.radians([90.0, 210.0, 330.0])
    corners = 2.0 * np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1) * 0.5
    mesh = newton.Mesh(corners.astype(np.float32), [0, 1, 2], compute_inertia=False)
    mesh.two_sided, mesh.foliage = True, foliage
    sim.static.add_shape_mesh(-1, xform=wp.transform((0, 0, 5), wp.quat_identity()), mesh=mesh, color=(0.1, 0.3, 0.05))
    fov = float(np.degrees(2.0 * np.arctan(HALF / 10.0)))
    view = {"eye": (0.0, 0.0, 15.0), "lookat": (0.0, 0.0, 5.0), "origin_type": "world", "fov": fov}
    renderer = SceneRenderer(sim, ViewerCfg(resolution=(SIZE, SIZE), natural=True, anti_aliasing=False, **view))
    renderer.render()
    shown = (renderer._tracer._main["shape"].numpy() != 0xFFFFFFFF).reshape(SIZE, SIZE)
    at = (np.arange(SIZE) + 0.5) / SIZE * 2.0 * HALF - HALF
    x, y = np.meshgrid(at, -at)
    inwards = turns + np.pi  # each edge lies opposite to a corner, half a metre from the middle
    away = np.max([-(x * np.cos(a) + y * np.sin(a)) * -1.0 - 0.5 for a in inwards], axis=0)
    return shown, away


@pytest.mark.parametrize("foliage", ["leaves", "spruce", "pine"])
def test_leaves_reach_over_the_edges_and_leave_gaps(foliage):
    whole, away = seen_triangle("")
    assert (whole == (away < 0.0)).mean() > 0.995  # no foliage: the triangle itself
    shown, away = seen_triangle(foliage)
    style = LEAF_STYLES[foliage]
    assert 0.4 < shown[away < -0.05].mean() < 0.95
    near = (away > 0.0) & (away < 0.5 * style["margin"])
    assert 0.02 < shown[near].mean() < shown[away < -0.05].mean()
    assert not shown[away > 2.1 * style["margin"]].any()  # corners move twice as far as edges
    again, _ = seen_triangle(foliage)
    np.testing.assert_array_equal(shown, again)


def test_edges_of_traced_triangles_lie_farther_out_by_the_margin():
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(50, 3, 3))
    traced = widened(corners, 0.01)
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        c, d = traced[:, k], traced[:, (k + 1) % 3]
        along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        np.testing.assert_allclose(np.abs((along * (d - c)).sum(axis=1)), np.linalg.norm(d - c, axis=1), rtol=1e-9)
        apart = (c - a) - along * ((c - a) * along).sum(axis=1, keepdims=True)
        slim = np.linalg.norm(d - c, axis=1) > 2.99 * np.linalg.norm(b - a, axis=1)  # at most three times as large
        np.testing.assert_allclose(np.linalg.norm(apart, axis=1)[~slim], 0.01, rtol=1e-6)
        assert slim.mean() < 0.2


def test_trees_say_what_their_foliage_is():
    scenery = read_scenery(ForestSpec((40.0, 40.0), density=600.0).create(1).stage)
    found = {mesh.foliage for prototype in scenery.prototypes for mesh, _ in prototype.meshes if mesh.two_sided}
    assert {"leaves", "spruce", "pine"} <= found
    assert not any(m.foliage for p in scenery.prototypes for m, _ in p.meshes if not m.two_sided)
    with pytest.raises(ValueError, match="foliage is 'palm', must be one of"):
        MeshPart("p", np.zeros((3, 3)), np.array([[0, 1, 2]]), foliage="palm")
