# SPDX-License-Identifier: Apache-2.0
"""Sight lines, against rays that MuJoCo casts, and the near plane of browsers that they set."""

from __future__ import annotations

import types

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from stripe_newton.viewers import SceneRenderer, ViewerCfg, sight_line
from stripe_newton.viewers.sight_line import SightLine
from tests.helpers.usd_stages import usda


def test_it_is_blocked_up_to_the_last_box_in_between():
    """Turned and stretched boxes and a hundred pairs of points around them; MuJoCo looks from the target."""
    rng, count = np.random.default_rng(0), 10
    sizes, turns = rng.uniform(0.3, 2.0, (count, 3)), Rotation.random(count, random_state=1).as_quat()
    poses = np.hstack((rng.uniform(-2.0, 2.0, (count, 3)), turns))
    line, box = SightLine(), trimesh.creation.box((1.0, 1.0, 1.0))
    line.add(np.array(box.vertices), np.array(box.faces), sizes, poses)
    geoms = "".join(
        f'<geom type="box" size="{_text(size / 2)}" pos="{_text(pose[:3])}" quat="{_text(np.roll(pose[3:], 1))}"/>'
        for size, pose in zip(sizes, poses, strict=True)
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found, expected = [], []
    for eye, target in rng.uniform(-4.0, 4.0, (100, 2, 3)):
        length = float(np.linalg.norm(target - eye))
        back = mujoco.mj_ray(model, data, target, (eye - target) / length, None, 1, -1, np.zeros(1, np.int32))
        expected.append(length - back if 0.0 <= back < length else 0.0)
        found.append(line.blocked_until(eye, target))
    assert 20 < np.count_nonzero(expected) < 100
    np.testing.assert_allclose(found, expected, atol=1e-6)


def _text(numbers):
    return " ".join(f"{number:.12g}" for number in numbers)


def test_a_wood_is_never_in_between(monkeypatch):
    monkeypatch.setattr(sight_line, "_MOST_TRIANGLES", 20)
    line, box = SightLine(), trimesh.creation.box((1.0, 1.0, 1.0))
    one = np.ones((1, 3)), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    line.add(box.vertices, box.faces, *one)
    assert line.blocked_until(np.array([-3.0, 0.1, 0.2]), np.array([3.0, 0.1, 0.2])) == pytest.approx(3.5)
    line.add(box.vertices, box.faces, *one)
    assert line.blocked_until(np.array([-3.0, 0.1, 0.2]), np.array([3.0, 0.1, 0.2])) == 0.0


def test_a_browser_draws_from_behind_the_wall(viewer, monkeypatch):
    camera = types.SimpleNamespace(position=np.array([4.0, 0.1, 0.6]), look_at=np.array([0.0, 0.1, 0.4]), near=0.01)
    monkeypatch.setattr(viewer.server, "get_clients", lambda: {0: types.SimpleNamespace(camera=camera)})
    wall, control = trimesh.creation.box((0.2, 4.0, 3.0)), viewer.camera

    def near():
        control._next_look = 0.0
        control.look_through(viewer.scene)
        return camera.near

    free = near()
    assert free <= 0.05
    at = control.to_world(np.array([2.0, 0.0, 0.0]))
    pose = np.array([[*at, 0.0, 0.0, 0.0, 1.0]])
    viewer.scene.sight_line.add(wall.vertices, wall.faces, np.ones((1, 3)), pose)
    assert near() == pytest.approx(2.1 * np.hypot(4.0, 0.2) / 4.0 + 0.05, abs=1e-6)
    control.see_through.value = False
    assert near() == free


def _room(walls: str) -> InteractiveScene:
    """A red ball on the floor between walls, given by their sides."""
    sides = {"x": (1.0, 0.0), "-x": (-1.0, 0.0), "y": (0.0, 1.0), "-y": (0.0, -1.0)}
    parts = {"floor": ((0.0, 0.0, -0.05), (9.0, 9.0, 0.1))}
    for side in walls.split():
        x, y = sides[side]
        parts[f"wall{len(parts)}"] = (0.6 * x, 0.6 * y, 2.0), (0.05 + 2.0 * abs(y), 0.05 + 2.0 * abs(x), 4.0)
    boxes = "".join(
        f'def Cube "{name}" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{\ndouble size = 1\n'
        f"double3 xformOp:translate = {at}\ndouble3 xformOp:scale = {size}\n"
        'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]\n}\n'
        for name, (at, size) in parts.items()
    )
    ball = """def Sphere "ball" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"]) {
        double radius = 0.2
        color3f[] primvars:displayColor = [(1, 0, 0)]
        double3 xformOp:translate = (0, 0, 0.2)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }"""
    return InteractiveScene.from_usd(usda(boxes + ball), sim_cfg=SimulationCfg(device="cpu"))


def _share_of_red(picture: np.ndarray) -> float:
    red, green = picture[..., 0].astype(int), picture[..., 1].astype(int)
    return float(((red > 100) & (red > 2 * green)).mean())


@pytest.mark.parametrize("walls", ["", "x -y", "x -x y -y"], ids=["without walls", "a corner", "closed"])
def test_a_camera_that_follows_sees_its_body_in_a_room(walls):
    """It turns to a free side, and in a closed room it comes in front of the wall."""
    scene = _room(walls)
    renderer = SceneRenderer(scene.sim, ViewerCfg(resolution=(64, 48)))
    assert _share_of_red(renderer.render()) > 0.02
    eye, target = renderer._seen_from
    away = np.linalg.norm(eye - target) / np.linalg.norm(renderer.eye - renderer.target)
    assert (away < 0.99) == (walls == "x -x y -y")
    scene.close()


@pytest.mark.parametrize("walls", ["x -y", "x -x y -y"], ids=["a corner", "closed"])
def test_a_camera_of_a_config_sees_the_body_that_it_follows(walls):
    """Also where an episode begins beside other walls than those of the first one."""
    scene = _room(walls)
    scene.sim.state.body_q.assign(np.array([[3.0, 3.0, 0.2, 0.0, 0.0, 0.0, 1.0]], dtype=np.float32))
    cfg = ViewerCfg(resolution=(64, 48), origin_type="asset_root", eye=(1.5, -1.5, 0.6), lookat=(0.0, 0.0, 0.0))
    renderer = SceneRenderer(scene.sim, cfg)
    assert _share_of_red(renderer.render()) > 0.02
    np.testing.assert_allclose(renderer.eye, (4.5, 1.5, 0.8), atol=1e-6)
    scene.sim.state.body_q.assign(np.array([[0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0]], dtype=np.float32))
    assert _share_of_red(renderer.render()) > 0.02
    scene.close()
