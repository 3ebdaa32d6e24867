# SPDX-License-Identifier: Apache-2.0
"""Picture layers: what ``debug_vis`` asks for is in pictures, where the sensors say, and nothing else is."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_newton.viewers.picture_layers import PictureLayers


def _asked(env, *names):
    """Layers of the environments 1 and 2, of which 2 is chosen, with ``debug_vis`` of some sensors."""
    for name in names:
        sensor = env.scene.sensors[name]
        sensor.cfg = SimpleNamespace(**vars(getattr(sensor, "cfg", SimpleNamespace())), debug_vis=True)
    return PictureLayers(env, [1, 2], 2)


def test_nothing_is_drawn_that_was_not_asked_for(env):
    with PictureLayers(env, [1, 2], 2).shown():
        assert env.sim.markers == []


def test_points_of_a_scan_are_where_its_rays_hit(env):
    layers = _asked(env, "scan")
    with layers.shown():
        (points,) = env.sim.markers
        hits = env.scene.sensors["scan"].data.ray_hits_w[2, :3].numpy()  # the fourth is infinite
        np.testing.assert_allclose(points.places().positions, hits + (0.0, 0.0, 0.012), atol=1e-5)
    assert len(points.places().positions) == 0  # the live view draws its own
    with layers.shown():
        assert len(points.places().positions) == 3
    assert len(env.sim.markers) == 1


def test_rays_of_a_lidar_are_lines_from_the_sensor_to_the_hits(env):
    with _asked(env, "lidar").shown():
        places = env.sim.markers[1].places()
        hits = env.scene.sensors["lidar"].data.ray_hits_w[2, :3].numpy()
        half = Rotation.from_quat(places.orientations).apply(
            np.column_stack([np.zeros((3, 2)), places.scales[:, 2] / 2])
        )
        np.testing.assert_allclose(places.positions + half, hits, atol=1e-4)
        np.testing.assert_allclose(places.positions - half, np.tile((1.0, 1.0, 1.5), (3, 1)), atol=1e-4)


def test_forces_are_arrows_along_them(env):
    with _asked(env, "feet").shown():
        places = env.sim.markers[0].places()
        tip = Rotation.from_quat(places.orientations).apply(places.scales * (1.0, 0.0, 0.0))
        length = min(1.5, 0.5 * 50.0 / (9.81 * env.sim.model.body_mass.numpy()[2]))
        np.testing.assert_allclose(tip, [(0.0, 0.0, length)], atol=1e-5)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_an_arrow_may_point_against_its_axis(axis):
    from stripe_newton.viewers.picture_layers import _turns

    ways = np.array([axis, np.negative(axis), (0.3, -2.0, 0.5)])
    turned = Rotation.from_quat(_turns(ways, axis)).apply(axis)
    np.testing.assert_allclose(turned, ways / np.linalg.norm(ways, axis=1, keepdims=True), atol=1e-9)


def test_a_picture_has_them_while_they_are_shown(env):
    cfg = ViewerCfg(eye=(6.0, -4.0, 3.0), lookat=(6.0, 0.0, 0.5), origin_type="world", resolution=(96, 64), env_index=2)
    renderer = SceneRenderer(env.sim, cfg)
    assert renderer.env_ids == [2]
    env.scene.sensors["feet"].data.net_forces_w *= 10.0
    layers, before = _asked(env, "feet"), renderer.render()
    with layers.shown():
        during = renderer.render()
    np.testing.assert_array_equal(renderer.render(), before)
    assert (np.abs(during.astype(int) - before).max(axis=2) > 30).sum() > 10
