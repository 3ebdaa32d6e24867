# SPDX-License-Identifier: Apache-2.0
"""Viewers: what pictures show, their light and floor, and the live page."""

from __future__ import annotations

import importlib.util
import math
import threading
from pathlib import Path

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.configclass import ConfigError
from stripe_newton.viewers import LiveViewer, SceneRenderer, ViewerCfg, tracer
from tests.helpers.forked import run_forked
from tests.helpers.viewed_scenes import SMALL, box, light, move, red_pixels, sim_of

ASSETS = Path(newton.__file__).parent / "examples" / "assets"
DEVICES = ["cpu", pytest.param("cuda:0", marks=pytest.mark.gpu)]


@pytest.mark.parametrize("device", DEVICES)
def test_a_red_box_is_red_where_it_stands_and_nowhere_else(device):
    sim = sim_of(box(), device=device)
    cfg = ViewerCfg(eye=(3.0, 0.0, 0.5), lookat=(0.0, 0.0, 0.5), resolution=SMALL, fov=40.0)
    red = red_pixels(SceneRenderer(sim, cfg).render())
    # the front face stands 2.85 m away; its half width of 0.15 m spans this many pixels
    half = 0.15 / 2.85 / math.tan(math.radians(20)) * SMALL[1] / 2
    np.testing.assert_allclose(red.mean(axis=0) + 0.5, (SMALL[1] / 2, SMALL[0] / 2), atol=0.6)
    np.testing.assert_allclose(red.max(axis=0) - red.min(axis=0) + 1, 2 * half, atol=1.5)


def test_a_large_floor_far_away_is_evenly_lit():
    """Newton's sensor finds no normal for many rays that hit a box farther away than some eight metres."""
    sim = sim_of(box(position=(0.0, 0.0, -9.0)), ground=False)
    pose = wp.transform(wp.vec3(0.0, 0.0, -0.1), wp.quat_identity())
    sim.static.add_shape_box(-1, xform=pose, hx=30.0, hy=30.0, hz=0.1, color=(0.9, 0.8, 0.6))
    cfg = ViewerCfg(eye=(-8.2, -8.2, 11.0), lookat=(0.0, 0.0, 0.0), resolution=SMALL, origin_type="world", fog=0.0)
    picture = SceneRenderer(sim, cfg).render().astype(int)
    assert max(np.abs(np.diff(picture, axis=axis)).max() for axis in (0, 1)) <= 3


def test_a_floor_under_a_low_sun_has_no_stripes():
    """Texels of the shadow map are larger than the floor's slope towards the sun allows: it must not shade itself."""
    low = math.radians(5.0)
    sun = light("distant", direction=(-math.cos(low), 0.3 * math.cos(low), -math.sin(low)))
    sim = sim_of(box(position=(0.0, 0.0, 0.5)), num_envs=5, ground=False, lights=[sun])
    sim.static.add_shape_box(-1, xform=wp.transform((0, 0, -1), wp.quat_identity()), hx=30.0, hy=30.0, hz=0.1)
    picture = SceneRenderer(sim, ViewerCfg(resolution=(320, 180), fog=0.0), range(5)).render().astype(int)
    near = picture[-50:]  # in front of the boxes, whose shadows fall behind them
    assert max(np.abs(np.diff(near, axis=axis)).max() for axis in (0, 1)) <= 1


def test_pictures_show_the_current_state_of_the_chosen_environments():
    sim = sim_of(box(), num_envs=4)
    cfg = ViewerCfg(eye=(3.0, 0.0, 0.5), lookat=(0.0, 0.0, 0.5), resolution=SMALL, env_index=2)
    renderer = SceneRenderer(sim, cfg)
    before = renderer.render()
    move(sim, 1, (0.0, 0.0, 0.3))  # another environment
    np.testing.assert_array_equal(renderer.render(), before)
    move(sim, 2, (0.0, 0.0, 0.3))
    assert red_pixels(renderer.render())[:, 0].mean() < red_pixels(before)[:, 0].mean() - 5


def mean_of(frame):
    return frame.reshape(-1, 3).mean(axis=0)


def test_lights_change_the_picture_and_usual_intensities_do_not_blow_out():
    def shot(*lights):
        sim = sim_of(box((0.8, 0.8, 0.8)), lights=lights)
        return SceneRenderer(sim, ViewerCfg(resolution=SMALL)).render()

    default = shot()
    usual = shot(light("dome", intensity=2000.0), light("distant", intensity=3000.0))
    warm = shot(light("dome", color=(1.0, 0.5, 0.2), intensity=2000.0))
    strong = shot(light("dome", intensity=20000.0), light("distant", intensity=30000.0))
    from_left = shot(light("distant", direction=(0.0, 0.7, -0.7)))
    from_right = shot(light("distant", direction=(0.0, -0.7, -0.7)))
    for frame in (default, usual, warm, strong):
        assert 60 < frame.mean() < 235
        assert (frame == 255).mean() < 0.02
    assert mean_of(warm)[0] - mean_of(warm)[2] > mean_of(usual)[0] - mean_of(usual)[2] + 20
    assert strong.mean() > usual.mean()
    assert np.abs(from_left.astype(int) - from_right).mean() > 4


def test_shadows_darken_the_ground_beside_the_box():
    sim = sim_of(box(), lights=[light("distant", direction=(0.0, 0.6, -0.8))])
    cfg = ViewerCfg(eye=(0.0, 0.0, 5.0), lookat=(0.0, 0.0, 0.0), resolution=SMALL)
    lit = SceneRenderer(sim, cfg.replace(shadows=False)).render().astype(int)
    shaded = SceneRenderer(sim, cfg).render().astype(int)
    darker = np.argwhere((lit - shaded).max(axis=-1) > 40)
    assert len(darker) > 10
    assert darker[:, 0].mean() < SMALL[1] / 2 - 3  # light travels towards +Y, which is up in the picture
    assert abs(darker[:, 1].mean() + 0.5 - SMALL[0] / 2) < 1
    assert len(darker) < 0.1 * SMALL[0] * SMALL[1]


def test_anti_aliasing_brings_colours_between_box_and_background():
    sim = sim_of(box())
    cfg = ViewerCfg(eye=(2.0, -1.3, 1.0), lookat=(0.0, 0.0, 0.5), resolution=SMALL, fog=0.0, shadows=False)
    smooth, hard = (SceneRenderer(sim, cfg.replace(anti_aliasing=on)).render() for on in (True, False))
    changed = (smooth != hard).any(axis=-1)
    assert 0.005 < changed.mean() < 0.2
    assert len(np.unique(smooth.reshape(-1, 3), axis=0)) > len(np.unique(hard.reshape(-1, 3), axis=0))


def held_box(color):
    template = newton.ModelBuilder()
    body = template.add_link(xform=wp.transform(wp.vec3(0.0, 0.0, 0.5), wp.quat_identity()), label="/World/Crate/base")
    template.add_shape_box(body, hx=0.15, hy=0.15, hz=0.15, color=color)
    template.add_articulation([template.add_joint_fixed(-1, body, parent_xform=template.body_q[body])])
    return template


def floor_brightness(template):
    """How much the lowest rows of a picture differ with a floor and without."""
    sim = sim_of(template, ground=False)
    pictures = [
        SceneRenderer(sim, ViewerCfg(resolution=SMALL, floor=on, recolor=True)).render().astype(int)
        for on in (True, False)
    ]
    return np.abs(pictures[0] - pictures[1])[-8:].mean(), pictures[1]


def threaded_renderer(monkeypatch, cores):
    """A renderer that shades all of a small picture in each frame after the first one, in a part for each core."""
    monkeypatch.setattr(tracer, "available_cores", lambda: cores)
    monkeypatch.setattr(tracer, "_LEAST_FOR_THREAD", 1)
    monkeypatch.setattr(tracer.PictureParts, "serves", lambda scene: False)
    renderer = SceneRenderer(sim_of(box()), ViewerCfg(resolution=(97, 61)))
    renderer.render()  # the first picture is always one thread's
    return renderer


def test_threads_shade_the_same_picture(monkeypatch):
    """On the CPU each computes a part of the pixels; the last part is shorter, and one thread computes all."""
    np.testing.assert_array_equal(*(threaded_renderer(monkeypatch, cores).render() for cores in (1, 5)))


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # that it has threads
def test_a_forked_process_shades_with_threads_of_its_own(monkeypatch):
    renderer = threaded_renderer(monkeypatch, 3)
    picture, meet = renderer.render(), threading.Barrier(tracer._MOST_THREADS)
    pool = renderer._open_tracer._pool
    list(pool.executor.map(lambda _: meet.wait(10.0), range(tracer._MOST_THREADS)))  # all are there, and free again
    assert run_forked(lambda: 7 if np.array_equal(renderer.render(), picture) else 8) == 7


def test_no_floor_is_drawn_unless_it_is_asked_for():
    template = held_box((0.1, 0.2, 0.9))
    renderer = SceneRenderer(sim_of(template, ground=False), ViewerCfg(resolution=SMALL))
    assert renderer._scene.model.shape_count == template.shape_count
    assert SceneRenderer(sim_of(template, ground=False), ViewerCfg(floor=True))._scene.model.shape_count == 2


def test_what_is_held_above_nothing_gets_a_floor_and_keeps_its_colour():
    difference, without = floor_brightness(held_box((0.1, 0.2, 0.9)))
    assert difference > 5
    assert (without[..., 2] - without[..., 0]).max() > 100


def test_no_floor_is_drawn_where_things_would_fall_through_it():
    standing = held_box((0.1, 0.2, 0.9))
    standing.add_shape_box(-1, hx=1.0, hy=1.0, hz=0.1)
    for template in (box(), standing):
        assert floor_brightness(template)[0] == 0.0


def test_textures_show():
    corners = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], dtype=np.float32)
    texture = np.zeros((8, 8, 4), dtype=np.uint8)
    texture[:, :4], texture[:, 4:] = (255, 0, 0, 255), (0, 0, 255, 255)
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    mesh = newton.Mesh(corners, np.array([0, 1, 2, 0, 2, 3]), uvs=uvs, texture=texture, compute_inertia=False)
    template = newton.ModelBuilder()
    template.add_shape_mesh(template.add_body(mass=1.0, inertia=wp.mat33(np.eye(3))), mesh=mesh, color=(1.0, 1.0, 1.0))
    cfg = ViewerCfg(eye=(4.0, 0.0, 0.0), lookat=(0.0, 0.0, 0.0), resolution=SMALL, shadows=False)
    frame = SceneRenderer(sim_of(template, ground=False), cfg.replace(floor=False)).render()
    left, right = frame[32, 40].astype(int), frame[32, 55].astype(int)
    assert left[0] > left[2] + 60
    assert right[2] > right[0] + 60


def test_ground_planes_that_coincide_are_traced_once():
    template = box()
    template.add_ground_plane()
    sim = sim_of(template, num_envs=4, ground=False)
    renderer = SceneRenderer(sim, ViewerCfg(resolution=SMALL), range(4))
    assert renderer._scene.model.bvh_shape_count_enabled == 4 + 1


@pytest.mark.parametrize("stage", ["cartpole_single_pendulum.usda", "ant.usda", "humanoid.usda"])
def test_packaged_stages_render(stage):
    template = newton.ModelBuilder()
    template.add_usd(str(ASSETS / stage))
    renderer = SceneRenderer(sim_of(template, num_envs=2), ViewerCfg(resolution=SMALL), [0, 1])
    frame = renderer.render()
    assert frame.shape == (64, 96, 3)
    assert frame.dtype == np.uint8
    assert frame.std() > 8
    renderer.close()
    renderer.close()
    with pytest.raises(RuntimeError, match="closed"):
        renderer.render()


def test_a_state_that_is_not_finite_still_gives_a_picture():
    sim = sim_of(box())
    renderer = SceneRenderer(sim, ViewerCfg(resolution=SMALL))
    renderer.render()
    move(sim, 0, np.nan)
    assert renderer.render().shape == (64, 96, 3)


def test_bad_configurations_and_environments_are_refused():
    cfg = ViewerCfg(lookat=(1, 2, 3), origin_type="robot", resolution=(0, 5.5), env_index=-1, fov=500.0)
    with pytest.raises(ConfigError) as error:
        cfg.validate()
    assert {p.split(":")[0] for p in error.value.problems} == {
        "eye", "origin_type", "resolution", "env_index", "fov",
    }  # fmt: skip
    with pytest.raises(ConfigError, match="same point"):
        ViewerCfg(eye=(1, 1, 1), lookat=(1, 1, 1)).validate()
    assert ViewerCfg(eye=(1, 2, 3)).validate() is None  # as in Isaac Lab's configs: it looks at the origin
    assert ViewerCfg(eye=(1, 2, 3)).aim == (0.0, 0.0, 0.0)
    assert ViewerCfg().aim is None
    with pytest.raises(IndexError, match=r"\[7\], expected some of 0 to 1"):
        SceneRenderer(sim_of(box(), num_envs=2), ViewerCfg(), env_ids=[0, 7])


def test_without_viser_the_live_viewer_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'pip install "stripe-newton\[viser\]"'):
        LiveViewer(sim_of(box()))


@pytest.mark.slow
def test_the_live_viewer_serves_a_page():
    pytest.importorskip("viser")
    import urllib.request

    with LiveViewer(sim_of(box(), num_envs=2), [0, 1], port=18463) as viewer:
        viewer.update()
        with urllib.request.urlopen(viewer.url, timeout=10) as page:
            assert page.status == 200
    with pytest.raises(RuntimeError, match="closed"):
        viewer.update()


def test_neighbours_are_shown_with_the_environment():
    sim = sim_of(box(), num_envs=6)
    for index, count, shown in ((2, 3, [2, 1, 3]), (0, 1, [0]), (5, 9, [5, 4, 3, 2, 1, 0])):
        renderer = SceneRenderer(sim, ViewerCfg(resolution=SMALL, env_index=index, num_shown=count))
        np.testing.assert_allclose(renderer._scene.body_q[:, 0], [3.0 * i for i in shown])
    named = SceneRenderer(sim, ViewerCfg(resolution=SMALL, num_shown=3), [4])
    assert len(named._scene.body_q) == 1
    with pytest.raises(ConfigError, match="num_shown"):
        ViewerCfg(num_shown=0).validate()
    with pytest.raises(IndexError, match="expected some of 0 to 5"):
        SceneRenderer(sim, ViewerCfg(env_index=6, num_shown=2))


def test_pictures_are_larger_where_pixels_are_cheap():
    assert ViewerCfg().size_on(is_gpu=True) == (1280, 720)
    assert ViewerCfg().size_on(is_gpu=False) == SceneRenderer(sim_of(box()), ViewerCfg()).render().shape[1::-1]
    assert ViewerCfg(resolution=(64, 32)).size_on(is_gpu=True) == (64, 32)


def test_far_neighbours_leave_the_followed_robot_its_shadow():
    sim = sim_of(box(position=(0.0, 0.0, 0.3)), num_envs=3, spacing=30.0)
    view = {"origin_type": "asset_root", "eye": (1.5, -1.5, 1.0), "lookat": (0.0, 0.0, 0.0), "resolution": SMALL}

    def dark(**options):
        lit, cast = (SceneRenderer(sim, ViewerCfg(**view, shadows=on, **options)).render() for on in (False, True))
        return int((lit.astype(int) - cast > 15).all(axis=-1).sum())

    alone = dark()
    assert alone > 30
    assert dark(num_shown=3) == pytest.approx(alone, rel=0.25)
    assert ViewerCfg().shadow_size_on(is_gpu=True) > ViewerCfg(num_shown=2).shadow_size_on(is_gpu=False) > 256
