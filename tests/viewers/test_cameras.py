# SPDX-License-Identifier: Apache-2.0
"""Cameras of viewers: framing, following, and where points appear in a picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_newton.viewers.camera_framing import Follower, camera_axes, frame_points
from tests.helpers.viewed_scenes import SMALL, box, move, red_pixels, sim_of


def test_an_object_off_the_middle_projects_to_the_expected_pixel():
    sim = sim_of(box(position=(0.0, 0.4, 0.8), half=0.05))
    cfg = ViewerCfg(eye=(3.0, 0.0, 0.5), lookat=(0.0, 0.0, 0.5), resolution=SMALL, fov=40.0, shadows=False)
    row, column = red_pixels(SceneRenderer(sim, cfg).render()).mean(axis=0) + 0.5
    pixels_per_tangent = SMALL[1] / 2 / math.tan(math.radians(20))
    assert column == pytest.approx(SMALL[0] / 2 + 0.4 / 2.97 * pixels_per_tangent, abs=1.2)  # +Y is right, seen from +X
    assert row == pytest.approx(SMALL[1] / 2 - 0.3 / 2.97 * pixels_per_tangent, abs=1.2)


def test_automatic_framing_shows_the_whole_of_each_environment():
    sim = sim_of(box(), num_envs=3)
    for env_ids in ([0], [2], [0, 1, 2]):
        red = red_pixels(SceneRenderer(sim, ViewerCfg(resolution=SMALL), env_ids).render())
        assert len(red) > 20
        assert red.min() > 0
        assert (red.max(axis=0) < np.array(SMALL[::-1]) - 1).all()


def test_framing_fits_points_and_centres_them():
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3)) * (1.0, 3.0, 0.5) + (4.0, -2.0, 1.0)
    fov, aspect, margin = math.radians(40), 16 / 9, 1.2
    eye, target = frame_points(points, 0.4, 0.3, fov, aspect, margin)
    seen = (points - eye) @ camera_axes(eye, target)
    x = seen[:, 0] / -seen[:, 2] / (math.tan(fov / 2) * aspect)
    y = seen[:, 1] / -seen[:, 2] / math.tan(fov / 2)
    assert max(np.abs(x).max(), np.abs(y).max()) == pytest.approx(1 / margin, rel=0.03)
    assert abs(x.max() + x.min()) < 0.05
    assert abs(y.max() + y.min()) < 0.05


@pytest.mark.parametrize("cfg", [ViewerCfg(), ViewerCfg(eye=(2, -2, 1), lookat=(0, 0, 0), origin_type="asset_root")])
def test_the_camera_keeps_a_robot_that_walks_away_in_the_middle(cfg):
    sim = sim_of(box())
    renderer = SceneRenderer(sim, cfg.replace(resolution=SMALL))
    start = red_pixels(renderer.render()).mean(axis=0)
    for _ in range(60):
        move(sim, 0, (0.05, 0.02, 0.0))
        frame = renderer.render()
    np.testing.assert_allclose(red_pixels(frame).mean(axis=0), start, atol=2.0)


def test_a_robot_that_was_moved_before_the_first_picture_is_in_it():
    sim = sim_of(box())
    renderer = SceneRenderer(sim, ViewerCfg(resolution=SMALL))
    move(sim, 0, (7.0, -4.0, 0.0))
    np.testing.assert_allclose(red_pixels(renderer.render()).mean(axis=0), (32, 48), atol=4)


def test_a_camera_placed_by_the_caller_stands_still():
    sim = sim_of(box())
    renderer = SceneRenderer(sim, ViewerCfg(resolution=SMALL))
    renderer.look((3.0, 0.0, 0.5), (0.0, 0.0, 0.5))
    before = red_pixels(renderer.render()).mean(axis=0)
    move(sim, 0, (0.0, 0.4, 0.0))
    after = red_pixels(renderer.render()).mean(axis=0)
    assert after[1] - before[1] > 8


def test_eye_is_relative_to_what_origin_type_says():
    sim = sim_of(box(), num_envs=3)
    cfg = ViewerCfg(eye=(3.0, 0.0, 1.0), lookat=(0.0, 0.0, 0.5), env_index=1, resolution=SMALL)
    np.testing.assert_allclose(SceneRenderer(sim, cfg).eye, (6.0, 0.0, 1.0))
    np.testing.assert_allclose(SceneRenderer(sim, cfg.replace(origin_type="world")).eye, (3.0, 0.0, 1.0))
    root = cfg.replace(origin_type="asset_root", asset_name="crate")
    np.testing.assert_allclose(SceneRenderer(sim, root).eye, (6.0, 0.0, 1.5))
    with pytest.raises(ValueError, match=r"no body has 'robot' in its path; there is Crate, World"):
        SceneRenderer(sim, root.replace(asset_name="robot"))


def test_a_camera_turns_with_the_heading():
    cfg = ViewerCfg(
        eye=(-1.5, 0.4, 0.6), lookat=(0.5, 0.0, 0.0), origin_type="asset_heading", asset_name="crate", resolution=SMALL,
        follow_time=0.0,
    )  # fmt: skip
    sim = sim_of(box())
    renderer = SceneRenderer(sim, cfg)
    renderer.render()
    yaw = 2.0
    poses = sim.state.body_q.numpy()
    poses[0, 3:] = [0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)]
    sim.state.body_q.assign(poses)
    behind = renderer.render()
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    middle = np.array([0.0, 0.0, 0.5])
    still = SceneRenderer(sim, cfg)
    still.look(middle + turn @ cfg.eye, middle + turn @ cfg.lookat)
    difference = np.abs(behind.astype(int) - still.render().astype(int))
    assert (difference > 8).mean() < 0.01
    assert len(red_pixels(behind)) > 20


def test_follower_does_not_lag_behind_steady_motion_and_jumps_with_a_reset():
    follower = Follower(time=8.0, jump=1.0)
    for i in range(100):
        at = follower.follow(np.array([0.1 * i, 0.0, 0.0]))
    assert at[0] == pytest.approx(9.9, abs=1e-3)
    np.testing.assert_allclose(follower.follow(np.zeros(3)), 0.0)
    np.testing.assert_allclose(follower.follow(np.full(3, np.nan)), 0.0)


def test_points_are_projected_to_where_the_picture_shows_them():
    sim = sim_of(box(position=(0.0, 0.4, 0.8), half=0.05))
    cfg = ViewerCfg(eye=(3.0, 0.0, 0.5), lookat=(0.0, 0.0, 0.5), resolution=SMALL, fov=40.0, shadows=False)
    renderer = SceneRenderer(sim, cfg)
    row, column = red_pixels(renderer.render()).mean(axis=0) + 0.5
    seen = renderer.project(np.array([[0.0, 0.4, 0.8], [0.0, 0.0, 0.5], [5.0, 0.0, 0.5]]))
    np.testing.assert_allclose(seen[0], (column, row), atol=1.0)
    np.testing.assert_allclose(seen[1], (SMALL[0] / 2, SMALL[1] / 2), atol=1e-9)
    assert np.isnan(seen[2]).all()  # behind the camera


def test_a_camera_follows_more_slowly_in_height():
    follower = Follower(np.array([4.0, 4.0, 16.0]), jump=10.0)
    follower.follow(np.zeros(3))
    found = follower.follow(np.array([0.3, 0.3, 0.3]))
    assert 0.0 < found[2] < 0.5 * found[0]
