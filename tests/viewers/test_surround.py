# SPDX-License-Identifier: Apache-2.0
"""Ground around a height field: without a gap, up to the horizon, and for the eye alone."""

from __future__ import annotations

import math

import newton
import numpy as np
import pytest
import trimesh
import warp as wp

from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_newton.viewers.surround import surround_mesh
from tests.helpers.viewed_scenes import sim_of

SIZE = (64, 180)
"""Columns and rows: a narrow picture, whose rows are compared."""


def field(rows=9, columns=7):
    heights = np.random.default_rng(1).uniform(-0.4, 0.6, (rows, columns))
    return newton.Heightfield(heights, rows, columns, hx=4.0, hy=6.0)


def test_the_ring_joins_the_edge_and_reaches_the_horizon():
    source = field()
    mesh = surround_mesh(source)
    ring = trimesh.Trimesh(mesh.vertices, np.asarray(mesh.indices).reshape(-1, 3), process=False)
    assert ring.is_winding_consistent
    assert (ring.face_normals[:, 2] > 0.0).all()
    # Two open edges: that of the field, at its points, and the horizon.
    border = ring.edges[trimesh.grouping.group_rows(ring.edges_sorted, require_count=1)]
    points = ring.vertices[np.unique(border)]
    is_inner = np.linalg.norm(points[:, :2], axis=1) < 10.0
    inner = points[is_inner]
    x, y = np.linspace(-4.0, 4.0, 7), np.linspace(-6.0, 6.0, 9)
    z = source.min_z + np.asarray(source.data).reshape(9, 7) * (source.max_z - source.min_z)
    grid = np.stack([*np.meshgrid(x, y), z], axis=-1)
    edge = np.concatenate([grid[0], grid[-1], grid[1:-1, 0], grid[1:-1, -1]])
    order = [np.lexsort(np.round(p, 3).T) for p in (inner, edge)]
    np.testing.assert_allclose(inner[order[0]], edge[order[1]], atol=1e-5)
    outer = points[~is_inner]
    assert np.linalg.norm(outer[:, :2], axis=1).min() > 1.3e4
    assert np.ptp(outer[:, 2]) < 1e-6


def terrain(lights=()):
    template = newton.ModelBuilder()
    body = template.add_body(xform=wp.transform((0.0, 0.0, 1.0), wp.quat_identity()))
    template.add_shape_box(body, hx=0.2, hy=0.2, hz=0.2)
    sim = sim_of(template, ground=False, lights=lights)
    sim.static.add_shape_heightfield(heightfield=field(), color=(0.3, 0.5, 0.2))
    return sim


@pytest.mark.parametrize("natural", [False, True])
def test_views_from_above_have_a_horizon(natural):
    pitch, fov = math.radians(12.0), math.radians(40.0)
    eye = np.array([0.0, -60.0, 25.0])
    view = {"eye": tuple(eye), "lookat": (0.0, 0.0, 25.0 - 60.0 * math.tan(pitch)), "origin_type": "world"}
    cfg = ViewerCfg(resolution=SIZE, fov=math.degrees(fov), natural=natural, anti_aliasing=False, **view)
    row = SIZE[1] * (0.5 - 0.5 * math.tan(pitch) / math.tan(0.5 * fov))

    def seen(**options):
        renderer = SceneRenderer(terrain(), cfg.replace(**options))
        picture = renderer.render().astype(int)
        return renderer._tracer._main["shape"].numpy().reshape(SIZE[::-1]) != 0xFFFFFFFF, picture

    ground, picture = seen()
    np.testing.assert_allclose(ground.argmax(axis=0), row, atol=1.5)
    assert ground[math.ceil(row) + 1 :].all()
    # Ground is green near the camera and has the colour of the sky where it ends.
    assert picture[-1, 5, 1] > picture[-1, 5, 2] + 20
    assert np.abs(picture[int(row) - 3, 5] - picture[int(row) + 3, 5]).max() < 25
    without, _ = seen(horizon=False)
    assert not without[: SIZE[1] // 2, 5].any()


def test_the_surround_changes_neither_framing_nor_planes():
    cameras = [SceneRenderer(terrain(), ViewerCfg(resolution=SIZE, horizon=on)) for on in (True, False)]
    np.testing.assert_array_equal(cameras[0].eye, cameras[1].eye)
    assert cameras[0]._scene.model.shape_count == cameras[1]._scene.model.shape_count + 1
    sim = terrain()
    sim.static.add_ground_plane()  # has a horizon of its own
    assert SceneRenderer(sim, ViewerCfg(resolution=SIZE))._scene.model.shape_count == 3
