# SPDX-License-Identifier: Apache-2.0
"""Live viewer: time, camera, environments and status, by the handles that a browser works, without a browser."""

from __future__ import annotations

import numpy as np
import pytest

from stripe_newton.viewers import LiveViewer, ViewerCfg
from tests.helpers.viewed_boxes import BoxEnv, BoxSim, take


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
    places = viewer.camera.to_world(batch.handle.batched_positions)
    np.testing.assert_allclose(places, env.box_positions, atol=1e-6)
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


def test_the_first_view_comes_back_with_its_field_of_view(viewer):
    first = viewer.camera.fov.value
    viewer.camera.fov.value = 70
    looks(viewer, 1)
    assert viewer.server.initial_camera.fov == pytest.approx(np.radians(70.0))
    viewer.camera.frame()
    assert viewer.camera.fov.value == first
    assert viewer.server.initial_camera.fov == pytest.approx(np.radians(first))


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


def test_update_waits_while_time_is_paused(viewer):
    """`update` returns at once when time goes on, and serves the page until a step is wanted when it does not."""
    viewer.update()
    viewer.time.set_paused(True)
    viewer.inbox.put(lambda: viewer.inbox.put(viewer.time.take_single_step))
    viewer.update()
    assert viewer.time.takes_step()
