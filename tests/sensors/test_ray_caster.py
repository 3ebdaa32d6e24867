# SPDX-License-Identifier: Apache-2.0
"""Ray casters: patterns, the height lookup against casts, shapes against closed forms, periods, drift, noise, delay."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_newton.configclass import ConfigError
from stripe_newton.noise import ConstantNoiseCfg, UniformNoiseCfg
from stripe_newton.sensors import (
    BpearlPatternCfg,
    GridPatternCfg,
    LidarPatternCfg,
    PinholeCameraPatternCfg,
    RayCasterCfg,
)
from tests.helpers.ray_world import add_field, add_mesh, body, place, random_poses, ray_scene, rays_of, surface_height
from tests.helpers.small_scenes import DT

GRID = GridPatternCfg(resolution=0.1, size=(1.6, 1.0))
LIDAR = LidarPatternCfg(
    channels=6, vertical_fov_range=(-60.0, 40.0), horizontal_fov_range=(-180.0, 180.0), horizontal_res=15.0
)
BODY = "{ENV_REGEX_NS}/Body"


def cfg(**changes):
    return RayCasterCfg(prim_path=BODY, pattern_cfg=GRID).replace(**changes)


def cast(sensor, build, poses, **options):
    """The sensor after one measurement, and what it measured, float64."""
    scene = ray_scene(sensor, build, len(poses), **options)
    place(scene, poses)
    made = scene.sensors["rays"]
    made.update(DT)
    return made, made.data.ray_hits_w.double().numpy()


# -- patterns


def test_a_grid_has_the_rays_of_isaac_lab():
    starts, directions = GRID.rays()
    assert starts.shape == (187, 3)
    np.testing.assert_allclose(starts[:2], [[-0.8, -0.5, 0.0], [-0.7, -0.5, 0.0]], atol=1e-12)
    np.testing.assert_allclose(starts[-1], [0.8, 0.5, 0.0], atol=1e-12)
    np.testing.assert_array_equal(directions, [[0.0, 0.0, -1.0]] * 187)
    by_y, _ = GRID.replace(ordering="yx").rays()
    np.testing.assert_allclose(by_y[1], [-0.8, -0.4, 0.0], atol=1e-12)


def test_other_patterns_point_where_they_should():
    _, lidar = LIDAR.rays()
    assert lidar.shape == (6 * 24, 3)  # the last azimuth is the first
    np.testing.assert_allclose(np.degrees(np.arcsin(lidar[0, 2])), -60.0)
    np.testing.assert_allclose(np.degrees(np.arcsin(lidar[-1, 2])), 40.0)
    part = LIDAR.replace(horizontal_fov_range=(0.0, 90.0), channels=1, vertical_fov_range=(0.0, 0.0))
    np.testing.assert_allclose(part.rays()[1][[0, -1]], [[1, 0, 0], [0, 1, 0]], atol=1e-12)
    _, dome = BpearlPatternCfg().rays()
    assert dome.shape == (32 * 36, 3)
    assert (dome[:, 2] > 0.0).all()
    k = [40.0, 0.0, 10.0, 0.0, 30.0, 8.0, 0.0, 0.0, 1.0]
    camera = PinholeCameraPatternCfg.from_intrinsic_matrix(k, width=24, height=16)
    np.testing.assert_allclose(camera.matrix(24, 16).ravel(), k, atol=1e-12)
    _, pixels = camera.rays()
    ray = pixels.reshape(16, 24, 3)[3, 20]
    np.testing.assert_allclose(ray / ray[0], [1.0, -(20.5 - 10.0) / 40.0, -(3.5 - 8.0) / 30.0], atol=1e-12)


# -- height fields


@pytest.mark.parametrize("alignment", ["yaw", "world"])
def test_the_lookup_is_the_surface_and_what_a_cast_finds(alignment):
    poses = random_poses(6, reach=2.5)
    looked, hits = cast(cfg(ray_alignment=alignment), add_field, poses)
    assert looked.method == "height field, lookup"
    starts, _ = rays_of(poses, *GRID.rays(), alignment)
    reference = starts.copy()
    reference[..., 2] = surface_height(starts[..., 0], starts[..., 1])
    reference[np.isinf(reference[..., 2])] = np.inf
    assert 0 < np.isinf(reference).sum() < 0.5 * reference.size
    np.testing.assert_allclose(hits, reference, atol=1e-5)
    meshed, cast_hits = cast(cfg(ray_alignment=alignment), add_mesh, poses)
    assert meshed.method == "shapes"
    assert (np.isinf(hits) == np.isinf(cast_hits)).all()
    np.testing.assert_allclose(hits, cast_hits, atol=1e-4)


def test_slanted_rays_march_over_the_field_as_they_hit_its_mesh():
    poses = random_poses(8, seed=1)
    sensor = cfg(pattern_cfg=LIDAR, ray_alignment="base", max_distance=4.0)
    marched, hits = cast(sensor, add_field, poses)
    assert marched.method == "height field, march"
    _, reference = cast(sensor, add_mesh, poses)
    same = np.isinf(hits[..., 0]) == np.isinf(reference[..., 0])
    assert same.mean() > 0.998  # at a silhouette, or at the length, rounding decides
    found = same & np.isfinite(hits[..., 0])
    assert found.mean() > 0.2
    near = np.linalg.norm(hits[found] - reference[found], axis=-1) < 1e-4
    assert near.mean() > 0.998
    above = hits[found][:, 2] - surface_height(hits[found][:, 0], hits[found][:, 1])
    assert np.abs(above).max() < 1e-4
    lengths = marched.data.distances.numpy()
    assert (lengths[np.isinf(hits[..., 0])] == 4.0).all()
    assert lengths.max() == 4.0


def test_a_level_plane_is_looked_up():
    def add_plane(template, static):
        static.add_shape_plane(plane=(0.0, 0.0, 1.0, -0.25), width=0.0, length=0.0, label="/World/ground/plane")

    poses = random_poses(4, seed=2, reach=900.0)
    down, hits = cast(cfg(ray_alignment="yaw"), add_plane, poses)
    assert down.method == "height field, lookup"
    np.testing.assert_allclose(hits[..., 2], 0.25, atol=1e-6)
    sensor = cfg(pattern_cfg=LIDAR)
    slanted, hits = cast(sensor, add_plane, poses)
    assert slanted.method == "height field, march"
    starts, directions = rays_of(poses, *LIDAR.rays(), "base")
    with np.errstate(divide="ignore"):
        length = (0.25 - starts[..., 2]) / directions[..., 2]
    reference = np.where((length > 0.0)[..., None], starts + length[..., None] * directions, np.inf)
    clear = np.abs(directions[..., 2]) > 0.02
    np.testing.assert_allclose(hits[clear], reference[clear], rtol=1e-5, atol=2e-3)
    np.testing.assert_allclose(hits[clear & (length > 0.0)][:, 2], 0.25, atol=1e-5)


# -- shapes

CENTRE, RADIUS, BOX, HALF = np.array([1.5, 0.5, 0.5]), 0.6, np.array([-1.5, -1.0, 0.4]), np.array([0.5, 0.4, 0.7])
TURN = Rotation.from_euler("xyz", [0.3, -0.2, 0.9])


def add_shapes(template, static):
    static.add_shape_sphere(-1, xform=wp.transform(wp.vec3(*CENTRE), wp.quat_identity()), radius=RADIUS)
    pose = wp.transform(wp.vec3(*BOX), wp.quat(*TURN.as_quat()))
    static.add_shape_box(-1, xform=pose, hx=HALF[0], hy=HALF[1], hz=HALF[2])
    static.add_shape_plane(plane=(0.0, 0.0, 1.0, 0.0), width=0.0, length=0.0)


def sphere_length(start, direction, centre=CENTRE, radius=RADIUS):
    to = centre - start
    along = (to * direction).sum(-1)
    square = radius**2 - (to**2).sum(-1) + along**2
    with np.errstate(invalid="ignore"):
        length = along - np.sqrt(square)
    return np.where((square > 0.0) & (length > 0.0), length, np.inf)


def box_length(start, direction):
    start, direction = TURN.inv().as_matrix() @ (start - BOX)[..., None], TURN.inv().as_matrix() @ direction[..., None]
    start, direction = start[..., 0], direction[..., 0]
    with np.errstate(divide="ignore"):
        ends = np.stack([(-HALF - start) / direction, (HALF - start) / direction])
    first, last = ends.min(0).max(-1), ends.max(0).min(-1)
    return np.where((first <= last) & (first > 0.0), first, np.inf)


def plane_length(start, direction):
    with np.errstate(divide="ignore"):
        length = -start[..., 2] / direction[..., 2]
    return np.where(length > 0.0, length, np.inf)


def test_rays_hit_sphere_box_and_plane_where_geometry_says():
    poses = random_poses(6, seed=3)
    dense = LIDAR.replace(channels=20, vertical_fov_range=(-80.0, 60.0), horizontal_res=5.0)
    made, hits = cast(cfg(pattern_cfg=dense, max_distance=10.0), add_shapes, poses)
    assert made.method == "height field, march, and shapes"  # the plane is a field
    starts, directions = rays_of(poses, *dense.rays(), "base")
    each = np.stack([f(starts, directions) for f in (sphere_length, box_length, plane_length)])
    length = each.min(0)
    length[length > 10.0] = np.inf
    for k in range(3):
        assert (each.argmin(0)[np.isfinite(length)] == k).sum() > 100
    got = made.data.distances.double().numpy()
    agree = np.isclose(got, np.minimum(length, 10.0), atol=1e-4)
    assert agree.mean() > 0.999  # a silhouette is met or missed by rounding
    near = agree & np.isfinite(length)
    np.testing.assert_allclose(hits[near], (starts + length[..., None] * directions)[near], atol=2e-4)
    assert np.isinf(hits[agree & np.isinf(length)]).all()


def test_rays_see_the_moving_bodies_of_their_own_environment():
    down = GridPatternCfg(resolution=0.1, size=(0.2, 0.2))
    scene = ray_scene(cfg(pattern_cfg=down, ray_alignment="world"), None, 3, others={"cube": body("Cube", 0.6)})
    made = scene.sensors["rays"]
    level = np.array([0.0, 0.0, 3.0, 0, 0, 0, 1])
    place(scene, np.tile(level, (3, 1)))
    poses = np.array([[0, 0, 0.5, 0, 0, 0, 1], [0, 0, 1.0, 0, 0, 0, 1], [50, 0, 1.5, 0, 0, 0, 1]], dtype=float)
    place(scene, poses, "cube")
    made.update(DT)
    top = made.data.ray_hits_w[..., 2].clone().numpy()
    np.testing.assert_allclose(top[0], 0.8, atol=1e-5)
    np.testing.assert_allclose(top[1], 1.3, atol=1e-5)
    assert np.isinf(top[2]).all()  # neither its own cube, nor that of others, nor itself
    poses[:, 2] += 0.25
    place(scene, poses, "cube")
    made.update(DT)
    np.testing.assert_allclose(made.data.ray_hits_w[:2, :, 2].numpy(), top[:2] + 0.25, atol=1e-5)
    np.testing.assert_allclose(made.data.pos_w.numpy(), np.tile(level[:3], (3, 1)))


def test_field_and_shapes_together_give_the_nearer_hit():
    def add_both(template, static):
        add_field(template, static)
        static.add_shape_sphere(-1, xform=wp.transform(wp.vec3(0.0, 0.0, 0.8), wp.quat_identity()), radius=0.3)

    poses = random_poses(5, seed=6, reach=0.3)
    poses[:, 2] += 1.0
    made, hits = cast(cfg(ray_alignment="yaw"), add_both, poses)
    assert made.method == "height field, march, and shapes"
    starts, directions = rays_of(poses, *GRID.rays(), "yaw")
    ball = starts[..., 2] - sphere_length(starts, directions, np.array([0.0, 0.0, 0.8]), 0.3)
    reference = np.maximum(ball, surface_height(starts[..., 0], starts[..., 1]))
    assert (ball == reference).any()
    clear = np.abs(np.hypot(starts[..., 0], starts[..., 1]) - 0.3) > 1e-3
    np.testing.assert_allclose(hits[..., 2][clear], reference[clear], atol=1e-4)
    only, hits = cast(cfg(ray_alignment="yaw", mesh_prim_paths=["/World/ground"]), add_both, poses)
    assert only.method == "height field, lookup"
    np.testing.assert_allclose(hits[..., 2], surface_height(starts[..., 0], starts[..., 1]), atol=1e-5)


def test_an_offset_turns_and_moves_the_rays():
    turn = Rotation.from_euler("xyz", [0.2, 0.1, 0.5])
    offset = RayCasterCfg.OffsetCfg(pos=(0.1, 0.2, 3.0), rot=tuple(turn.as_quat()))
    sensor = cfg(offset=offset, pattern_cfg=LIDAR, ray_alignment="yaw")
    poses = random_poses(3, seed=4)
    made, _ = cast(sensor, add_shapes, poses)
    starts, directions = LIDAR.rays()
    starts, directions = rays_of(poses, turn.apply(starts) + [0.1, 0.2, 3.0], turn.apply(directions), "yaw")
    length = np.min([f(starts, directions) for f in (sphere_length, box_length, plane_length)], axis=0)
    near = length < 20.0
    got = made.data.distances.double().numpy()
    assert np.isclose(got[near], length[near], atol=2e-4).mean() > 0.998
    np.testing.assert_allclose(made.data.pos_w.numpy(), poses[:, :3], atol=1e-6)  # of the body, as in Isaac Lab
    np.testing.assert_allclose(np.abs((made.data.quat_w.numpy() * poses[:, 3:]).sum(-1)), 1.0, atol=1e-6)


# -- time, drift, noise, delay


def move(scene, z):
    count = scene.num_envs
    place(scene, np.tile([0.3, 0.1, z, 0.0, 0.0, 0.0, 1.0], (count, 1)))


def test_a_period_is_obeyed_and_a_new_episode_measures():
    scene = ray_scene(cfg(ray_alignment="yaw", update_period=3 * DT), add_field, 2)
    sensor, seen = scene.sensors["rays"], []
    for step in range(7):
        if step == 4:
            sensor.launch_reset(wp.array([False, True], dtype=wp.bool))
        move(scene, 1.0 + step)
        sensor.update(DT)
        seen.append(sensor.data.pos_w[:, 2].tolist())
    assert [row[0] for row in seen] == [1.0, 1.0, 1.0, 4.0, 4.0, 4.0, 7.0]
    assert [row[1] for row in seen] == [1.0, 1.0, 1.0, 4.0, 5.0, 5.0, 5.0]
    with pytest.raises(ConfigError, match=r"update_period"):
        ray_scene(cfg(update_period=1.5 * DT), add_field, 2)


def test_drift_is_drawn_for_an_episode():
    ranges = {"x": (0.1, 0.3), "z": (-0.2, 0.0)}
    sensor = cfg(ray_alignment="yaw", drift_range=(-0.5, 0.5), ray_cast_drift_range=ranges)
    scene = ray_scene(sensor, add_field, 4)
    made = scene.sensors["rays"]
    made.reset()
    move(scene, 2.0)
    made.update(DT)
    drift = made.data.pos_w.numpy() - [0.3, 0.1, 2.0]
    assert (np.abs(drift) <= 0.5).all()
    assert len(np.unique(drift)) == 12
    hits = made.data.ray_hits_w.double().numpy()
    shift = hits[:, 0, :2] - made.data.pos_w.numpy()[:, :2] - GRID.rays()[0][0, :2]
    assert ((shift[:, 0] > 0.1) & (shift[:, 0] < 0.3)).all()
    np.testing.assert_allclose(shift[:, 1], 0.0, atol=1e-6)
    raised = hits[..., 2] - surface_height(hits[..., 0], hits[..., 1])
    np.testing.assert_allclose(raised, np.tile(raised[:, :1], (1, 187)), atol=1e-5)
    assert ((raised[:, 0] > -0.2) & (raised[:, 0] < 0.0)).all()
    made.update(DT)
    assert np.array_equal(made.data.ray_hits_w.double().numpy(), hits)
    made.reset([2])
    made.update(DT)
    assert (made.data.pos_w.numpy() - [0.3, 0.1, 2.0] == drift).all(axis=1).tolist() == [True, True, False, True]


def test_noise_changes_lengths_along_the_rays_and_delay_the_time():
    sensor = cfg(ray_alignment="yaw", noise=UniformNoiseCfg(n_min=0.01, n_max=0.05), max_distance=5.0)
    scene = ray_scene(sensor, add_field, 3)
    made = scene.sensors["rays"]
    move(scene, 2.0)
    made.update(DT)
    first = made.data.ray_hits_w.double().numpy()
    depth = surface_height(first[..., 0], first[..., 1]) - first[..., 2]
    assert ((depth > 0.0099) & (depth < 0.0501)).all()
    assert len(np.unique(depth.round(7))) > 500
    np.testing.assert_allclose(made.data.distances.numpy(), 2.0 - first[..., 2], atol=1e-5)
    move(scene, 9.0)
    made.update(DT)
    assert torch.isinf(made.data.ray_hits_w).all()  # noise brings nothing into reach
    assert (made.data.distances == 5.0).all()
    late = ray_scene(cfg(ray_alignment="yaw", noise=ConstantNoiseCfg(bias=0.5), delay=2), add_field, 2)
    made, seen = late.sensors["rays"], []
    for step in range(5):
        move(late, 2.0 + step)
        made.update(DT)
        seen.append(made.data.pos_w[0, 2].item())
        hits = made.data.ray_hits_w[0].double().numpy()
        np.testing.assert_allclose(surface_height(hits[:, 0], hits[:, 1]) - hits[:, 2], 0.5, atol=1e-5)
    assert seen == [2.0, 2.0, 2.0, 3.0, 4.0]
    made.reset([0])
    made.update(DT)
    assert made.data.pos_w[:, 2].tolist() == [6.0, 5.0]


def test_an_environment_does_not_depend_on_how_many_there_are():
    sensor = cfg(ray_alignment="yaw", drift_range=(-0.1, 0.1), noise=UniformNoiseCfg(n_min=-0.1, n_max=0.1))
    poses, hits = random_poses(5, seed=8), []
    for count in (2, 5):
        scene = ray_scene(sensor, add_field, count)
        scene.sensors["rays"].reset()
        place(scene, poses[:count])
        for _ in range(2):
            scene.sensors["rays"].update(DT)
        hits.append(scene.sensors["rays"].data.ray_hits_w.clone())
    assert torch.equal(hits[0], hits[1][:2])


# -- errors


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ray_alignment": "up"}, r"ray_alignment: is 'up', must be"),
        ({"pattern_cfg": GRID.replace(resolution=0.0)}, r"pattern_cfg.resolution: is 0.0"),
        ({"max_distance": 0.0}, r"max_distance"),
        ({"mesh_prim_paths": "/World/ground"}, r"must be a sequence"),
        ({"delay": -1}, r"delay: is -1"),
        ({"drift_range": (0.0, math.inf)}, r"drift_range"),
    ],
)
def test_a_wrong_config_says_what_would_be_right(changes, message):
    with pytest.raises(ConfigError, match=message):
        cfg(**changes).validate()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mesh_prim_paths": ["/World/Ground"]}, r"no collider at or below '/World/Ground'; there is /World/ground"),
        ({"prim_path": "{ENV_REGEX_NS}/Bdy"}, r"Bdy"),
        ({"mesh_prim_paths": [BODY]}, r"which carries it"),
    ],
)
def test_what_is_not_in_the_scene_is_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        ray_scene(cfg(**changes), add_field, 1)
