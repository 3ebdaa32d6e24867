# SPDX-License-Identifier: Apache-2.0
"""Live panels: commands, pushes, plots, checkpoints and joints, by the handles that a browser works."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.viewers import LiveViewer
from stripe_newton.viewers.live.signals import signals_of
from tests.helpers.viewed_boxes import BoxEnv, BoxSim, take


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


def test_curves_begin_anew_when_somebody_looks_again(viewer, env, monkeypatch):
    """Nothing is read while no browser is connected: a line across that time would be made up."""
    looks = True
    monkeypatch.setattr(viewer, "has_clients", lambda: looks)
    plot = viewer.plots.plots[0]

    def serve(steps):
        for _ in range(steps):
            take(viewer, env, 1)
            viewer._serve_page(at_once=True)

    serve(4)
    viewer.plots._next = 0.0
    viewer._draw()
    chart = plot.chart
    assert chart is not None
    assert len(plot.data()[0]) >= 4
    looks = False
    serve(30)
    looks = True
    serve(3)
    np.testing.assert_allclose(np.diff(plot.data()[0]), env.step_dt, rtol=1e-5)
    viewer.plots._next = 0.0
    viewer._draw()
    assert plot.chart is chart  # the browser may still be told of its values
    assert len(chart.data[0]) == 3


def test_a_chart_is_made_anew_for_other_curves(viewer, env):
    plot = viewer.plots.plots[0]
    for name, curves in (("reward: total", 1), ("command: velocity", 3)):
        plot.choice.value = name
        viewer.inbox.run()
        assert plot.chart is None
        for _ in range(3):
            take(viewer, env, 1)
            viewer.plots._next = 0.0
            viewer._draw()
        assert len(plot.chart.data) == 1 + curves
    plot.choice.value = "off"
    viewer.inbox.run()
    assert plot.chart is None


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


def test_a_panel_that_fails_is_left_out_and_the_rest_goes_on(viewer, env, capsys):
    env.scene.sensors["scan"].data.ray_hits_w = None
    viewer.overlays.boxes["rays: scan"].value = True
    for _ in range(2):
        take(viewer, env, 1)
        viewer._draw()
    assert capsys.readouterr().err.count("NoneType") == 1
    assert viewer.inbox.problems[0].startswith("drawing rays: scan: no longer updated: TypeError")


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
