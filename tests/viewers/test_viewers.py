# SPDX-License-Identifier: Apache-2.0
"""Viewers: pictures, cameras, videos and the live page."""

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
from stripe_newton.viewers import LiveViewer, SceneRenderer, VideoWriter, ViewerCfg, save_image, tracer
from stripe_newton.viewers.camera_framing import Follower, camera_axes, frame_points
from tests.helpers.forked import run_forked
from tests.helpers.viewed_scenes import light, sim_of

ASSETS = Path(newton.__file__).parent / "examples" / "assets"
SMALL = (96, 64)
DEVICES = ["cpu", pytest.param("cuda:0", marks=pytest.mark.gpu)]


def box(color=(0.9, 0.05, 0.05), position=(0.0, 0.0, 0.5), half=0.15):
    template = newton.ModelBuilder()
    body = template.add_body(xform=wp.transform(wp.vec3(*position), wp.quat_identity()), label="/World/Crate/base")
    template.add_shape_box(body, hx=half, hy=half, hz=half, color=color)
    return template


def move(sim, env, offset):
    count = sim.template.body_count
    poses = sim.state.body_q.numpy()
    poses[env * count : (env + 1) * count, :3] += offset
    sim.state.body_q.assign(poses)


def red_pixels(frame):
    """Row and column of the pixels that are clearly red, shape (n, 2)."""
    r, g, b = (frame[..., i].astype(int) for i in range(3))
    return np.argwhere((r > 90) & (r > 2 * g) & (r > 2 * b))


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


@pytest.mark.parametrize("size", [(64, 48), (65, 47)])
def test_a_video_reads_back_with_its_frames(tmp_path, size):
    av = pytest.importorskip("av")
    path = tmp_path / "new" / "clip.mp4"
    with VideoWriter(path, fps=25) as video:
        for i in range(12):
            video.add(np.full((size[1], size[0], 3), 20 * i, dtype=np.uint8))
        assert not path.exists()
    assert [p.name for p in path.parent.iterdir()] == ["clip.mp4"]
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
        assert stream.codec_context.name == "h264"
        assert stream.pix_fmt == "yuv420p"
        assert stream.average_rate == 25
    assert len(frames) == 12
    assert frames[0].shape == (size[1] + size[1] % 2, size[0] + size[0] % 2, 3)
    np.testing.assert_allclose([f.mean() for f in frames], [20 * i for i in range(12)], atol=6)


def write_video(path, *frames):
    with VideoWriter(path, fps=30) as video:
        for frame in frames:
            video.add(frame)


def test_an_interrupted_video_leaves_nothing_and_bad_frames_are_refused(tmp_path):
    frame = np.zeros((32, 32, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match=r"shape \(16, 32, 3\), the first one had"):
        write_video(tmp_path / "a.mp4", frame, frame[:16])
    with pytest.raises(ValueError, match="float64"):
        write_video(tmp_path / "b.mp4", frame, np.zeros((32, 32, 3)))
    with pytest.raises(ValueError, match="without a frame"):
        write_video(tmp_path / "c.mp4")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="fps"):
        VideoWriter(tmp_path / "e.mp4", fps=0)
    with pytest.raises(ValueError, match=r"\.mp4"):
        VideoWriter(tmp_path / "e.avi", fps=30)


@pytest.mark.parametrize("ends", [True, False], ids=["at the end", "at a frame"])
def test_a_video_that_cannot_be_written_says_so_and_leaves_nothing(tmp_path, ends):
    """The thread that encodes meets the error, the caller gets it."""

    class FullDisk:
        def encode(self, picture):
            raise OSError(28, "No space left on device")

    def write():
        frame = np.zeros((32, 32, 3), dtype=np.uint8)
        with VideoWriter(tmp_path / "a.mp4", fps=30) as video:
            video.add(frame)
            video._stream = FullDisk()
            for _ in range(1 if ends else 1000):
                video.add(frame)

    with pytest.raises(OSError, match="No space left"):
        write()
    assert list(tmp_path.iterdir()) == []


def test_an_array_that_is_drawn_into_again_is_another_frame(tmp_path):
    av = pytest.importorskip("av")
    frame = np.zeros((32, 32, 3), dtype=np.uint8)
    with VideoWriter(tmp_path / "a.mp4", fps=30) as video:
        for i in range(8):
            frame[:] = 30 * i
            video.add(frame)
    with av.open(str(tmp_path / "a.mp4")) as container:
        means = [f.to_ndarray(format="rgb24").mean() for f in container.decode(video=0)]
    np.testing.assert_allclose(means, [30 * i for i in range(8)], atol=6)


def test_an_image_reads_back(tmp_path):
    image = pytest.importorskip("PIL.Image")
    frame = np.arange(20 * 30 * 3, dtype=np.uint32).astype(np.uint8).reshape(20, 30, 3)
    save_image(tmp_path / "a" / "x.png", frame)
    np.testing.assert_array_equal(np.asarray(image.open(tmp_path / "a" / "x.png")), frame)
    with pytest.raises(ValueError, match="no image ending"):
        save_image(tmp_path / "x.txt", frame)


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
