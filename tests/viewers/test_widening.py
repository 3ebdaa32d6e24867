# SPDX-License-Identifier: Apache-2.0
"""A view that gets wider where a robot on a fixed base reaches out of it."""

import math

import numpy as np
import pytest

from stripe_newton.sim import Simulation, SimulationCfg
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_newton.viewers.camera_framing import camera_axes
from stripe_newton.viewers.widening import WideningView

VIEW = (math.radians(-55.0), math.radians(13.0), math.radians(35.0), 16.0 / 9.0, 1.35)
HANGS = np.array([[0.0, 0.0, 1.2], [0.05, 0.05, 0.4]])
STANDS = np.array([[0.0, 0.0, 1.2], [0.05, 0.05, 2.0]])


def places(points, eye, target):
    """Places in the picture, -1 and 1 at its edges, shape (n, 2)."""
    seen = (points - eye) @ camera_axes(eye, target)
    half = math.tan(0.5 * VIEW[2]) * -seen[:, 2]
    return seen[:, :2] / np.stack([VIEW[3] * half, half], axis=1)


def test_an_arm_that_swings_up_stays_in_the_picture():
    view = WideningView(HANGS, VIEW, time=8.0)
    first = view.show(HANGS)
    assert np.abs(places(HANGS, *first)).max() < 1.0 < np.abs(places(STANDS, *first)).max()
    moves = []
    for _ in range(100):
        eye, target = view.show(STANDS)
        moves.append(eye)
    assert np.abs(places(np.concatenate((HANGS, STANDS)), eye, target)).max() < 1.0
    assert np.linalg.norm(np.diff(moves, axis=0), axis=1).max() < 0.3 * np.linalg.norm(moves[-1] - first[0])
    for _ in range(20):  # it has come to rest, and does not come nearer again
        np.testing.assert_allclose(view.show(HANGS)[0], eye, atol=1e-3)


def test_points_of_a_world_that_diverged_are_left_out():
    view = WideningView(HANGS, VIEW, time=0.0)
    eye, target = view.show(HANGS)
    np.testing.assert_array_equal(view.show(np.array([[1e6, 0.0, 0.0]])), (eye, target))


@pytest.mark.parametrize(("cfg", "moves"), [(ViewerCfg(), True), (ViewerCfg(follow=False), False)])
def test_the_renderer_moves_back_for_a_fixed_arm(hanging_arm, cfg, moves):
    renderer = SceneRenderer(hanging_arm.sim, cfg.replace(resolution=(64, 36), follow_time=0.0))
    tip = np.array([[0.0, 0.0, 2.0]])
    renderer.render()
    assert not 0.0 <= renderer.project(tip)[0, 1] <= 36.0
    hanging_arm["arm"].data.joint_pos[:] = math.pi
    hanging_arm.sim.forward()
    renderer.render()
    assert (0.0 <= renderer.project(tip)[0, 1] <= 36.0) == moves
    renderer.look((3.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    renderer.render()
    np.testing.assert_allclose(renderer.project(np.array([[0.0, 0.0, 1.0]])), [[32.0, 18.0]], atol=1e-6)


@pytest.fixture
def hanging_arm(tmp_path):
    from stripe_newton.assets import ArticulationCfg, file_spawner
    from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg

    file = tmp_path / "arm.xml"
    file.write_text(
        '<mujoco><worldbody><body name="link" pos="0 0 1.2"><joint name="hinge" axis="0 1 0"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -0.8" size="0.04" mass="1"/></body></worldbody></mujoco>'
    )
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=2.0), Simulation(SimulationCfg(device="cpu")))
    init = ArticulationCfg.InitialStateCfg(pos=None, joint_pos=None)
    cfg = ArticulationCfg(prim_path="{ENV_REGEX_NS}/Arm", spawn=file_spawner(file), init_state=init, actuators={})
    scene.builder.build_robot("arm", cfg)
    scene.build()
    return scene
