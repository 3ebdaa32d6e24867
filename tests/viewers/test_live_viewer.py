# SPDX-License-Identifier: Apache-2.0
"""Live viewer: its panels, worked by the handles that a browser works, without a browser."""

from __future__ import annotations

import io
import json
import struct
import types

import newton
import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.shape_mesh import shape_mesh
from stripe_newton.sim import SphereCfg
from stripe_newton.viewers import LiveViewer, ViewerCfg, VisualizationMarkers, VisualizationMarkersCfg
from stripe_newton.viewers.live.glb_file import glb_of
from stripe_newton.viewers.live.merged_field import merged_field
from stripe_newton.viewers.live.poses import compose, rotate, yaw_of
from stripe_newton.viewers.live.signals import signals_of
from tests.helpers.viewed_boxes import BoxEnv, BoxSim

viser = pytest.importorskip("viser")


@pytest.fixture
def env():
    return BoxEnv()


@pytest.fixture
def viewer(env):
    with LiveViewer(env, port=18500) as viewer:
        viewer.time.speed.value = "as fast as possible"
        yield viewer


def take(viewer, env, count):
    """Take so many steps as the page lets."""
    for _ in viewer.steps(count):
        env.step()


def looks(viewer, turns=20):
    """Steps that are due in so many looks at the page."""
    due = 0
    for _ in range(turns):
        viewer._serve_page()
        due += viewer.time.takes_step()
    return due


def test_steps_are_taken_until_the_limit(viewer, env):
    take(viewer, env, 5)
    assert env.common_step_counter == viewer.time.steps == 5


def test_pause_stops_time_and_a_single_step_takes_one(viewer, env):
    steps = viewer.steps()
    next(steps)
    env.step()
    viewer.time.pause_button.value = True  # a click
    assert looks(viewer) == 0
    assert viewer.time.pause_button.label == "Play"
    viewer.time.buttons.value = "Step"
    next(steps)
    env.step()
    assert env.common_step_counter == 2
    viewer.time.count_step()
    assert looks(viewer) == 0
    viewer.time.pause_button.value = True
    assert looks(viewer) > 0


def test_a_step_pauses_what_runs(viewer):
    viewer.time.buttons.value = "Step"
    looks(viewer, 1)
    assert viewer.time.is_paused


def test_clicks_on_step_add_up(viewer, env):
    viewer.time.set_paused(True)
    for _ in range(3):
        viewer.time.buttons.value = "Step"
    for _ in zip(range(3), viewer.steps()):
        env.step()
    viewer.after_step()  # the third, which the generator has not come back from
    assert looks(viewer) == 0
    assert env.common_step_counter == 3


def test_reset_begins_new_episodes(viewer, env):
    take(viewer, env, 7)
    viewer.time.buttons.value = "Reset"
    looks(viewer, 1)
    assert env.resets == 1
    assert not env.episode_length_buf.any()
    np.testing.assert_allclose(env.box_positions[:, 0], env.sim.env_origins[:, 0], atol=1e-6)


def test_speed_paces_the_steps(env, monkeypatch):
    clock = {"now": 0.0}
    monkeypatch.setattr("stripe_newton.viewers.live.time_control.time.monotonic", lambda: clock["now"])
    with LiveViewer(env, port=18510) as viewer:
        viewer.time.speed.value = "1/2"
        viewer.inbox.run()
        taken = 0
        for _ in range(200):  # 2 s in centiseconds: at half speed 1 s of simulated time, 50 steps of 0.02 s
            clock["now"] += 0.01
            if viewer.time.takes_step():
                viewer.after_step()
                taken += 1
        assert taken == pytest.approx(50, abs=1)
        assert viewer.time.factor == pytest.approx(0.5, abs=0.03)


def test_the_chosen_environment_is_followed_and_shown(viewer, env):
    take(viewer, env, 10)
    viewer.envs.number.value = 2
    viewer.envs.way.value = "this one"
    viewer.inbox.run()
    assert viewer.scene.env_ids == [2]
    np.testing.assert_allclose(viewer.camera.center, env.box_positions[2], atol=1e-6)
    np.testing.assert_allclose(viewer.camera._root.position, -env.box_positions[2], atol=1e-6)


@pytest.mark.parametrize(
    ("way", "count", "chosen", "shown"),
    [
        ("nearest", 3, 4, [3, 4, 5]),
        ("group", 3, 4, [3, 4, 5]),
        ("group", 4, 6, [4, 5, 6]),
        ("all", 1, 0, list(range(7))),
    ],
)
def test_environments_are_shown_in_groups(way, count, chosen, shown):
    with LiveViewer(BoxEnv(7), port=18520) as viewer:
        viewer.envs.count.value, viewer.envs.number.value, viewer.envs.way.value = count, chosen, way
        viewer.inbox.run()
        assert viewer.scene.env_ids == shown


def test_shapes_stand_where_the_simulation_has_them(viewer, env):
    take(viewer, env, 3)
    viewer._draw()
    (batch,) = viewer.scene.batches
    np.testing.assert_allclose(batch.handle.batched_positions, env.box_positions, atol=1e-6)
    np.testing.assert_allclose(batch.handle.batched_scales, [[0.2, 0.1, 0.1]] * 4, atol=1e-6)
    assert viewer.scene.body_of(int(batch.bodies[3])) == (3, 0)


def test_a_diverged_environment_does_not_take_the_camera_along(viewer, env):
    before = viewer.camera.center.copy()
    poses = env.sim.state.body_q.numpy().copy()
    poses[0] = np.nan
    env.sim.state.body_q.assign(poses)
    viewer._draw()
    assert np.isfinite(viewer.scene.batches[0].handle.batched_positions).all()
    np.testing.assert_allclose(viewer.camera.center, before)


def test_the_config_says_where_the_camera_is(env):
    cfg = ViewerCfg(eye=(4.0, 0.0, 1.0), lookat=(0.0, 0.0, 0.5), origin_type="env", env_index=0, follow=False)
    with LiveViewer(env, cfg=cfg, port=18530) as viewer:
        camera = viewer.server.initial_camera
        eye = np.asarray(camera.position) + viewer.camera.center
        np.testing.assert_allclose(eye, (4.0, 0.0, 1.0), atol=1e-6)


def test_the_status_says_episode_and_rewards(viewer, env):
    take(viewer, env, 4)
    viewer.envs.number.value = 2
    viewer.inbox.run()
    viewer.set_status({"iteration": "7 of 10"})
    viewer.status.update(2, at_once=True)
    text = viewer.status.text.content
    for words in ("step 4 of 100", "2 in this step, 8 in this episode", "iteration", "7 of 10"):
        assert words in text


def test_returns_are_those_of_ended_episodes(viewer, env):
    take(viewer, env, 100)
    mean, count = viewer.status.meter.mean_return()
    assert (mean, count) == (pytest.approx(100 * (0 + 1 + 2 + 3) / 4), 4)


def test_sliders_show_the_tasks_commands_until_somebody_moves_one(viewer, env):
    term, panel = env.command_manager.terms["velocity"], viewer.commands
    sliders = panel.sliders["velocity"]
    assert [(s.min, s.max) for s in sliders.values()] == [(-2.0, 2.0), (-1.0, 1.0), (-1.5, 1.5)]
    term.command[0] = torch.tensor([0.5, -0.25, 1.0])
    panel.update(at_once=True)
    viewer.inbox.run()
    assert [s.value for s in sliders.values()] == pytest.approx([0.5, -0.25, 1.0])
    assert not panel.hold["velocity"].value
    sliders["lin_vel_x"].value = -1.5
    viewer.inbox.run()
    assert panel.hold["velocity"].value
    assert term.command[0].tolist() == pytest.approx([-1.5, -0.25, 1.0])
    assert term.command[1].tolist() == pytest.approx([0.25] * 3)
    assert not (term.is_heading_env[0] | term.is_standing_env[0])
    term.command[0] = 9.0  # a new episode, which draws a command
    take(viewer, env, 1)
    assert term.command[0].tolist() == pytest.approx([-1.5, -0.25, 1.0])


def test_commands_go_back_to_the_task(viewer, env):
    term, panel = env.command_manager.terms["velocity"], viewer.commands
    panel.everywhere["velocity"].value = True
    panel.sliders["velocity"]["ang_vel_z"].value = 1.25
    viewer.inbox.run()
    assert term.command[:, 2].tolist() == pytest.approx([1.25] * 4)
    assert (term.time_left > 1000.0).all()
    panel.everywhere["velocity"].value = False
    viewer.inbox.run()
    assert (term.time_left > 1000.0).tolist() == [True, False, False, False]
    panel.hold["velocity"].value = False
    viewer.inbox.run()
    assert (term.time_left == 0.0).all()


def test_another_choice_takes_the_held_command_along(viewer, env):
    term = env.command_manager.terms["velocity"]
    viewer.commands.sliders["velocity"]["lin_vel_x"].value = 1.0
    viewer.inbox.run()
    viewer.envs.number.value = 3
    viewer.inbox.run()
    assert term.command[3, 0] == pytest.approx(1.0)
    assert term.time_left.tolist()[:3] == [0.0, 3.0, 3.0]


def test_a_pose_is_set_by_angles(viewer, env):
    rotations = pytest.importorskip("scipy.spatial.transform").Rotation
    sliders = viewer.commands.sliders["pose"]
    for name, value in {"pos_y": 0.5, "roll": 0.3, "pitch": -0.2, "yaw": 0.7}.items():
        sliders[name].value = value
    viewer.inbox.run()
    pose = env.command_manager.terms["pose"].command[0]
    assert pose[:3].tolist() == pytest.approx([0.0, 0.5, 0.0])
    expected = rotations.from_euler("xyz", [0.3, -0.2, 0.7]).as_matrix()
    np.testing.assert_allclose(rotations.from_quat(pose[3:].numpy()).as_matrix(), expected, atol=1e-6)
    viewer.commands.release()
    viewer.commands.update(at_once=True)
    assert [s.value for s in sliders.values()] == pytest.approx([0.0, 0.5, 0.0, 0.3, -0.2, 0.7], abs=1e-5)


def test_a_dragged_body_comes_to_where_it_is_dragged(viewer, env):
    target = env.box_positions[1] + (1.0, 0.5, 0.75)
    viewer.pushes.strength.value = 100
    viewer.pushes.begin_drag(1, 0, np.zeros(3), target)
    before = env.box_positions.copy()
    take(viewer, env, 150)
    # The boxes slide along x, too, against which the spring gives way.
    np.testing.assert_allclose(env.box_positions[1], target + (0.05, 0.0, 0.0), atol=0.06)
    np.testing.assert_allclose(env.box_positions[0], before[0] + (1.5, 0.0, 0.0), atol=1e-4)
    viewer.pushes.end_drag()
    assert not env.sim.external_wrench.numpy().any()


def test_a_drag_in_the_browser_holds_the_point_that_was_grabbed(viewer, env):
    """Points come in the frame of the page, which moves with the camera."""
    viewer.envs.number.value = 2
    viewer.inbox.run()
    grabbed = env.box_positions[1] + (0.2, 0.0, 0.0)
    (batch,) = viewer.scene.batches
    points = [viewer.camera.to_scene(p) for p in (grabbed, grabbed + (0.0, 0.0, 1.0))]
    viewer.pushes._handle("start", int(batch.bodies[1]), points[0], points[0])
    viewer.pushes._handle("update", int(batch.bodies[1]), *points)
    drag = viewer.pushes._drag
    assert (drag.env_id, drag.body) == (1, 0)
    np.testing.assert_allclose(drag.anchor, (0.2, 0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(drag.target, grabbed + (0.0, 0.0, 1.0), atol=1e-6)
    viewer.pushes._handle("end", int(batch.bodies[1]), *points)
    assert not viewer.pushes.is_dragging


def test_plots_have_the_values_of_the_steps(viewer, env):
    plot = viewer.plots.plots[0]
    assert plot.name == "reward: total"
    plot.choice.value = "command: velocity"
    viewer.envs.number.value = 2
    viewer.inbox.run()
    values = []
    for step in range(5):
        env.step()
        viewer.after_step()
        env.command_manager.terms["velocity"].command[2] = torch.tensor([step, 2.0 * step, 0.0])
        viewer._draw()
        values.append([step, 2.0 * step, 0.0])
    times, *curves = plot.data()
    np.testing.assert_allclose(np.diff(times), 0.02)
    np.testing.assert_allclose(np.stack(curves, axis=1)[-5:], values)
    viewer.plots._next = 0.0
    viewer._draw()
    assert [s["label"] for s in plot.chart.series][1:] == ["0", "1", "2"]
    np.testing.assert_allclose(plot.chart.data[1], plot.data()[1])


def test_what_is_logged_can_be_plotted(viewer, env):
    env.extras = {"log": {"Episode_Reward/alive": torch.tensor(2.5), "text": "no number"}}
    take(viewer, env, 1)
    env.extras = {"log": {}}
    assert "log: Episode_Reward/alive" in viewer.plots.plots[0].choice.options
    assert "log: text" not in viewer.plots.names
    plot = viewer.plots.add("log: Episode_Reward/alive")
    for _ in range(3):
        take(viewer, env, 1)
        viewer._draw()
    np.testing.assert_allclose(plot.data()[1], 2.5)


def test_observations_of_a_long_vector_are_offered_in_pieces():
    env = BoxEnv()
    env.obs_buf = {"policy": torch.arange(4 * 30).reshape(4, 30), "picture": torch.zeros(4, 8, 8, 3)}
    names = {signal.name: signal for signal in signals_of(env)}
    pieces = [name for name in names if name.startswith("observation")]
    assert pieces == ["observation: policy 0 to 11", "observation: policy 12 to 23", "observation: policy 24 to 29"]
    assert list(names[pieces[2]].read(1)) == list(range(54, 60))


def drawn(viewer, name, part=0):
    """The node that a layer has made."""
    layer = viewer.overlays.layers[name]
    return layer._drawings[part]._handle


def test_measurements_of_sensors_are_drawn_when_they_are_switched_on(viewer, env):
    viewer._draw()
    assert drawn(viewer, "rays scan") is None
    for box in viewer.overlays.boxes.values():
        box.value = True
    viewer.envs.number.value = 1
    viewer.inbox.run()
    viewer._draw()
    hits = env.scene.sensors["scan"].data.ray_hits_w[1, :3].numpy()
    np.testing.assert_allclose(
        drawn(viewer, "rays scan").points, hits + (0.0, 0.0, 0.012), atol=1e-5
    )  # without the one that is infinite
    assert drawn(viewer, "rays scan", 1) is None  # lines of a scan from above would hide everything
    lines = drawn(viewer, "rays lidar", 1).points
    np.testing.assert_allclose(lines[:, 0], np.tile((1.0, 1.0, 1.5), (3, 1)))
    np.testing.assert_allclose(lines[:, 1], hits)
    start, end = drawn(viewer, "contact forces feet").points[0]
    np.testing.assert_allclose(start, env.box_positions[1], atol=1e-6)
    weight = 9.81 * env.sim.model.body_mass.numpy()[1]
    np.testing.assert_allclose(end - start, (0.0, 0.0, min(1.5, 0.5 * 50.0 / weight)), atol=1e-5)
    assert drawn(viewer, "frames frames").batched_positions.shape == (2, 3)
    viewer.overlays.boxes["rays scan"].value = False
    viewer.inbox.run()
    viewer._draw()
    assert drawn(viewer, "rays scan") is None


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
        goals = drawn(viewer, "command pose")
        np.testing.assert_allclose(goals.batched_positions, [[0.0, 1.0, 0.5], [3.0, 1.0, 0.5]], atol=1e-6)
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
        np.testing.assert_allclose(handle.batched_positions, [[0.0, 0.0, 2.0], [3.0, 0.0, 2.0]], atol=1e-6)
        assert viewer.overlays.boxes["markers"].visible
        markers.visualize(env.sim.env_origins, marker_indices=[0, 1, 0, 0])
        viewer._draw()
        handles = viewer.overlays.layers["markers"]._batches.handles
        assert [len(h.batched_positions) for h in handles.values()] == [1, 1]
        viewer.overlays.boxes["markers"].value = False
        viewer.inbox.run()
        assert not any(h.visible for h in handles.values())


def test_a_panel_that_fails_is_left_out_and_the_rest_goes_on(viewer, env, capsys):
    env.scene.sensors["scan"].data.ray_hits_w = None
    viewer.overlays.boxes["rays scan"].value = True
    for _ in range(2):
        take(viewer, env, 1)
        viewer._draw()
    assert capsys.readouterr().err.count("NoneType") == 1
    assert viewer.inbox.problems[0].startswith("drawing rays scan: no longer updated: TypeError")


class Policies:
    """Checkpoints of a policy, one of which cannot be read."""

    def __init__(self):
        self.current, self.there, self.loads = "model_10", ["model_5", "model_10"], []

    def names(self):
        return self.there

    def load(self, name):
        self.loads.append(name)
        if name == "model_20":
            raise ValueError("not whole")
        self.current = name


def test_checkpoints_are_switched_and_the_newest_is_taken_by_itself(env, capsys):
    policies = Policies()
    with LiveViewer(env, checkpoints=policies, port=18580) as viewer:
        panel = viewer.policy
        assert (panel.choice.value, panel.choice.options, panel.newest.value) == (
            "model_10",
            ("model_10", "model_5"),
            True,
        )
        panel.choice.value = "model_5"
        viewer.inbox.run()
        assert (policies.current, panel.newest.value) == ("model_5", False)
        policies.there.append("model_15")
        panel.update(at_once=True)
        assert policies.current == "model_5"
        panel.newest.value = True
        viewer.inbox.run()
        assert (policies.current, panel.choice.value) == ("model_15", "model_15")
        policies.there.append("model_20")
        for _ in range(2):
            panel.update(at_once=True)
        assert policies.loads == ["model_5", "model_15", "model_20"]  # a bad one is not tried again
        assert policies.current == panel.choice.value == "model_15"
        assert "not whole" in capsys.readouterr().err
        policies.there.append("model_25")
        panel.update(at_once=True)
        assert policies.current == "model_25"


def test_an_error_of_a_panel_ends_nothing(viewer, env, capsys):
    viewer.inbox.put(lambda: 1 / 0)
    take(viewer, env, 2)
    assert env.common_step_counter == 2
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_a_simulation_or_a_scene_is_shown_too():
    with LiveViewer(BoxSim(2), [1], port=18540) as viewer:
        assert viewer.scene.env_ids == [1]
        assert viewer.time.buttons.options == ("Step",)
    with pytest.raises(TypeError, match="int has no simulation"):
        LiveViewer(3)
    with pytest.raises(IndexError, match="9"):
        LiveViewer(BoxSim(2), [9], port=18540)


def test_joints_of_what_is_inspected_move_by_sliders(monkeypatch):
    sim = BoxSim(1)
    sim.template = newton.ModelBuilder()
    lid = sim.template.add_link(label="/World/Box/lid")
    sim.template.add_shape_box(lid, hx=0.1, hy=0.5, hz=0.01)
    hinge = sim.template.add_joint_revolute(
        -1, lid, parent_xform=wp.transform((0.0, 0.0, 0.6), wp.quat_identity()), axis=(1.0, 0.0, 0.0),
        child_xform=wp.transform((0.0, -0.5, 0.0), wp.quat_identity()), limit_lower=-0.5, limit_upper=2.0,
    )  # fmt: skip
    sim.template.add_articulation([hinge])
    builder = newton.ModelBuilder()
    builder.add_world(sim.template)
    sim.model = builder.finalize(device="cpu")
    sim.state = sim.model.state()
    sim.forward = lambda: newton.eval_fk(sim.model, sim.state.joint_q, sim.state.joint_qd, sim.state)
    sim.forward()
    with LiveViewer(sim, port=18590) as viewer:
        looks = []

        def wait():
            looks.append(1)
            (slider,) = viewer.joints.sliders.values()
            if len(looks) == 1:
                assert (slider.min, slider.max) == pytest.approx((-0.5, 2.0))
                slider.value = 1.571
            else:
                viewer.close()

        monkeypatch.setattr(viewer.time, "wait", wait)
        viewer.hold()
    np.testing.assert_allclose(sim.state.body_q.numpy()[0, :3], (0.0, 0.0, 1.1), atol=1e-3)


def test_update_waits_while_time_is_paused(viewer):
    """`update` returns at once when time goes on, and serves the page until a step is wanted when it does not."""
    viewer.update()
    viewer.time.set_paused(True)
    viewer.inbox.put(lambda: viewer.inbox.put(viewer.time.take_single_step))
    viewer.update()
    assert viewer.time.takes_step()


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
