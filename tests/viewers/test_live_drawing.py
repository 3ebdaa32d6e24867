# SPDX-License-Identifier: Apache-2.0
"""Live drawing: sensors, commands, cameras and markers in the live view, and the geometry that it sends."""

from __future__ import annotations

import io
import json
import struct
import types

import newton
import numpy as np
import pytest
import torch

from stripe_newton.shape_mesh import shape_mesh
from stripe_newton.sim import SphereCfg
from stripe_newton.viewers import LiveViewer, VisualizationMarkers, VisualizationMarkersCfg
from stripe_newton.viewers.live.glb_file import glb_of
from stripe_newton.viewers.live.merged_field import merged_field
from stripe_newton.viewers.poses import compose, rotate, yaw_of
from tests.helpers.viewed_boxes import BoxEnv

viser = pytest.importorskip("viser")


def drawn(viewer, name, part=0):
    """The node that a layer has made."""
    layer = viewer.overlays.layers[name]
    return layer._drawings[part]._handle


def test_measurements_of_sensors_are_drawn_when_they_are_switched_on(viewer, env):
    viewer._draw()
    assert drawn(viewer, "rays: scan") is None
    for box in viewer.overlays.boxes.values():
        box.value = True
    viewer.envs.number.value = 1
    viewer.inbox.run()
    viewer._draw()
    hits = env.scene.sensors["scan"].data.ray_hits_w[1, :3].numpy()
    to_world = viewer.camera.to_world
    np.testing.assert_allclose(
        to_world(drawn(viewer, "rays: scan").points), hits + (0.0, 0.0, 0.012), atol=1e-5
    )  # without the one that is infinite
    assert drawn(viewer, "rays: scan", 1) is None  # lines of a scan from above would hide everything
    lines = to_world(drawn(viewer, "rays: lidar", 1).points)
    np.testing.assert_allclose(lines[:, 0], np.tile((1.0, 1.0, 1.5), (3, 1)), atol=1e-5)
    np.testing.assert_allclose(lines[:, 1], hits, atol=1e-5)
    start, end = to_world(drawn(viewer, "contact forces: feet").points[0])
    np.testing.assert_allclose(start, env.box_positions[1], atol=1e-6)
    weight = 9.81 * env.sim.model.body_mass.numpy()[1]
    np.testing.assert_allclose(end - start, (0.0, 0.0, min(1.5, 0.5 * 50.0 / weight)), atol=1e-5)
    assert drawn(viewer, "frames: frames").batched_positions.shape == (2, 3)
    viewer.overlays.boxes["rays: scan"].value = False
    viewer.inbox.run()
    viewer._draw()
    assert drawn(viewer, "rays: scan") is None


def test_a_pose_command_is_drawn_in_the_frame_of_the_robot():
    rotations = pytest.importorskip("scipy.spatial.transform").Rotation
    env = BoxEnv(2)
    turn = rotations.from_euler("z", 0.5 * np.pi).as_quat()
    data = types.SimpleNamespace(
        root_pos_w=torch.tensor([[0.0, 0.0, 0.5], [3.0, 0.0, 0.5]]), root_quat_w=torch.tensor(np.tile(turn, (2, 1)))
    )
    env.scene = Assets(env.scene, robot=types.SimpleNamespace(data=data))
    pose = env.command_manager.terms["pose"]
    pose.cfg.asset_name = "robot"
    pose.command[:, 0] = 1.0
    with LiveViewer(env, port=18560) as viewer:
        goals = drawn(viewer, "command: pose")
        places = viewer.camera.to_world(goals.batched_positions)
        np.testing.assert_allclose(places, [[0.0, 1.0, 0.5], [3.0, 1.0, 0.5]], atol=1e-6)
        np.testing.assert_allclose(goals.batched_wxyzs[0], (np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)), atol=1e-6)


class Assets(types.SimpleNamespace):
    """A scene that knows assets by name."""

    def __init__(self, scene, **assets):
        super().__init__(**vars(scene))
        self._assets = assets

    def __getitem__(self, name):
        return self._assets[name]


def test_cameras_show_their_pictures(viewer, env):
    viewer.envs.number.value = 3
    viewer.inbox.run()
    viewer.pictures._next = 0.0
    viewer._draw()
    rgb, depth = (viewer.pictures.images["camera", kind].image for kind in ("rgb", "depth"))
    assert (rgb == 128).all()
    assert rgb.shape == (4 * 27, 6 * 27, 3)  # enlarged to see the pixels
    assert depth[0, 0, 0] > depth[-1, -1, 0]  # near is light
    assert depth[0, 0, 0] == 255
    frustum = viewer.pictures._frustums["camera"]
    np.testing.assert_allclose(frustum.position, 2.0)
    x, y, z = (viser.transforms.SO3(frustum.wxyz).as_matrix()[:, k] for k in range(3))
    np.testing.assert_allclose([x, y, z], [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-9)  # right, down, ahead
    assert frustum.fov == pytest.approx(2 * np.arctan(1.0))
    viewer.pictures.is_on.value = False
    viewer.inbox.run()
    assert not viewer.pictures.images["camera", "rgb"].visible


def test_markers_of_the_shown_environments_are_drawn(env):
    cfg = VisualizationMarkersCfg(markers={"ball": SphereCfg(radius=0.1), "hidden": SphereCfg(radius=0.2)})
    with LiveViewer(env, [0, 1], port=18570) as viewer:
        assert not viewer.overlays.boxes["markers"].visible
        markers = VisualizationMarkers(cfg, env.sim)
        markers.visualize(env.sim.env_origins + (0.0, 0.0, 2.0))
        viewer._draw()
        (handle,) = viewer.overlays.layers["markers"]._batches.handles.values()
        places = viewer.camera.to_world(handle.batched_positions)
        np.testing.assert_allclose(places, [[0.0, 0.0, 2.0], [3.0, 0.0, 2.0]], atol=1e-6)
        assert viewer.overlays.boxes["markers"].visible
        markers.visualize(env.sim.env_origins, marker_indices=[0, 1, 0, 0])
        viewer._draw()
        handles = viewer.overlays.layers["markers"]._batches.handles
        assert [len(h.batched_positions) for h in handles.values()] == [1, 1]
        viewer.overlays.boxes["markers"].value = False
        viewer.inbox.run()
        assert not any(h.visible for h in handles.values())


def test_a_glb_file_has_what_was_put_in():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
    data = glb_of(vertices, np.array([[0, 1, 2]]), uvs=vertices[:, :2], picture=np.full((4, 5, 3), 90, np.uint8))
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    content, rest = json.loads(data[20 : 20 + size]), data[28 + size :]
    assert kind == b"JSON"

    def values(index, dtype):
        accessor = content["accessors"][index]
        view = content["bufferViews"][accessor["bufferView"]]
        return np.frombuffer(rest, dtype, view["byteLength"] // 4, view["byteOffset"])

    primitive = content["meshes"][0]["primitives"][0]
    np.testing.assert_array_equal(values(primitive["attributes"]["POSITION"], np.float32).reshape(3, 3), vertices)
    np.testing.assert_array_equal(values(primitive["attributes"]["NORMAL"], np.float32).reshape(3, 3), [[0, 0, 1]] * 3)
    np.testing.assert_array_equal(values(primitive["indices"], np.uint32), [0, 1, 2])
    view = content["bufferViews"][content["images"][0]["bufferView"]]
    image = pytest.importorskip("PIL.Image").open(io.BytesIO(rest[view["byteOffset"] :][: view["byteLength"]]))
    assert image.size == (5, 4)


def test_a_merged_height_field_is_the_same_surface_in_fewer_triangles():
    rows, columns = 150, 97
    x, y = np.meshgrid(0.1 * np.arange(columns), 0.1 * np.arange(rows))
    rng = np.random.default_rng(0)
    heights = np.where(y > 8.0, 0.3 * x, np.floor(x / 1.5) * 0.2)  # a slope, and stairs
    heights[30:45, 40:60] += rng.uniform(0.0, 0.1, (15, 20))  # rubble
    points = np.stack([x, y, heights], axis=-1)
    vertices, faces = merged_field(points)
    assert len(faces) < 0.25 * 2 * (rows - 1) * (columns - 1)
    edges = vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    normals = np.cross(*edges)
    assert (normals[:, 2] > 0.0).all()
    # Each edge has a triangle on both sides, but for the rim.
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    ends, count = np.unique(sides, axis=0, return_counts=True)
    rim = vertices[ends[count == 1]]
    on_rim = [(rim[..., k] == limit).all(axis=1) for k in (0, 1) for limit in (0.0, points[..., k].max())]
    assert count.max() == 2
    assert np.any(on_rim, axis=0).all()
    assert 0.5 * normals[:, 2].sum() == pytest.approx(0.1 * (rows - 1) * 0.1 * (columns - 1))  # all of the ground, once
    # Heights between the vertices, by the triangles of all cells and by the merged ones.
    where = rng.uniform((0.0, 0.0), (0.1 * (columns - 1), 0.1 * (rows - 1)), (400, 2))
    whole = newton.Heightfield(heights, rows, columns, hx=0.05 * (columns - 1), hy=0.05 * (rows - 1))
    full = shape_mesh(newton.GeoType.HFIELD, np.ones(3), whole, "field")
    shift = np.array([0.05 * (columns - 1), 0.05 * (rows - 1), 0.0])
    np.testing.assert_allclose(
        heights_at(vertices, faces, where), heights_at(full[0] + shift, full[1], where), atol=1e-3
    )


def flat_cross(a, b):
    """Third component of products of vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def heights_at(vertices, faces, where):
    """Heights of a surface of triangles at points, shape (n, 2)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    found = np.full(len(where), np.nan)
    det = flat_cross(b[:, :2] - a[:, :2], c[:, :2] - a[:, :2])
    for i, point in enumerate(where):
        v = flat_cross(point - a[:, :2], c[:, :2] - a[:, :2]) / det
        w = flat_cross(b[:, :2] - a[:, :2], point - a[:, :2]) / det
        k = int(np.argmax(np.minimum(np.minimum(v, w), 1.0 - v - w)))
        found[i] = a[k, 2] + v[k] * (b[k, 2] - a[k, 2]) + w[k] * (c[k, 2] - a[k, 2])
    return found


def test_poses_compose_as_scipy_has_it():
    rotations = pytest.importorskip("scipy.spatial.transform").Rotation
    rng = np.random.default_rng(3)
    a, b = (np.column_stack([rng.normal(size=(9, 3)), rotations.random(9, rng).as_quat()]) for _ in range(2))
    found = compose(a, b)
    turns = rotations.from_quat(a[:, 3:])
    np.testing.assert_allclose(found[:, :3], a[:, :3] + turns.apply(b[:, :3]), atol=1e-12)
    np.testing.assert_allclose(rotate(a[:, 3:], b[:, :3]), turns.apply(b[:, :3]), atol=1e-12)
    expected = (turns * rotations.from_quat(b[:, 3:])).as_matrix()
    np.testing.assert_allclose(rotations.from_quat(found[:, 3:]).as_matrix(), expected, atol=1e-12)
    assert yaw_of(rotations.from_euler("z", 0.7).as_quat()) == pytest.approx(0.7)
