# SPDX-License-Identifier: Apache-2.0
"""Walks by a depth camera: the teacher's observations, and what the picture shows of the ground."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import stripe_tasks  # noqa: F401
from stripe_newton.cli.tasks import load_cfg
from tests.helpers.small_tasks import small_cfg

ROUGH, FOREST = "Stripe-Velocity-Rough-Quadruped-Depth-v0", "Stripe-Forest-Walk-Quadruped-Depth-v0"


@pytest.mark.parametrize("task", [ROUGH, FOREST])
def test_the_teacher_observes_what_the_task_without_depth_does(task):
    own, other = (load_cfg(name, "env").to_dict()["observations"] for name in (task, task.replace("-Depth", "")))
    teacher, policy = own["teacher"], other["policy"]
    terms = [name for name, term in policy.items() if isinstance(term, dict) and "func" in term]
    assert [name for name, term in teacher.items() if isinstance(term, dict) and "func" in term] == terms
    assert all(teacher[name] == policy[name] for name in terms)
    assert policy["enable_corruption"]
    assert not teacher["enable_corruption"]
    # Nothing that a robot cannot measure.
    student = {name for name, term in own["policy"].items() if isinstance(term, dict) and "func" in term}
    assert student == set(terms) - {"base_lin_vel", "height_scan", "trunks"}
    assert load_cfg(task, "agent").obs_groups == {"student": ["policy", "depth"], "teacher": ["teacher"]}


def test_the_picture_shows_the_ground():
    cfg = small_cfg(ROUGH, seed=3)
    terrain = cfg.scene.terrain.terrain_generator
    terrain.num_rows, terrain.num_cols, terrain.border_width = 3, 3, 4.0
    cfg.scene.terrain.max_init_terrain_level = 2
    cfg.scene.depth_camera.noise, cfg.scene.depth_camera.delay = None, 0
    env = gymnasium.make_vec(ROUGH, cfg=cfg)
    obs, _ = env.reset(seed=3)
    for _ in range(3):
        obs, *_ = env.step(torch.zeros(4, 12))
    assert {name: tuple(value.shape[1:]) for name, value in obs.items()} == {
        "policy": (45,),
        "depth": (1, 48, 64),
        "teacher": (235,),
    }
    camera, field = env.unwrapped.scene["depth_camera"], env.unwrapped.scene.terrain.struct
    mount = camera.data.mount
    assert (mount != camera.data.default_mount).any(dim=1).all()
    depth = camera.data.output["distance_to_image_plane"][..., 0].double().numpy()
    shown = depth < 2.9
    np.testing.assert_allclose(obs["depth"][:, 0].numpy(), np.minimum(depth, 3.0) / 3.0, atol=1e-6)
    # Back to the world by the camera's matrix, and down to the ground.
    k = camera.data.intrinsic_matrices[0].double().numpy()
    x = (np.arange(64) + 0.5 - k[0, 2]) / k[0, 0]
    y = (np.arange(48) + 0.5 - k[1, 2]) / k[1, 1]
    rays = np.stack(np.broadcast_arrays(1.0, -x, -y[:, None]), axis=-1)  # of the frame with x forward and z up
    turn = Rotation.from_quat(camera.data.quat_w_world.double().numpy()).as_matrix()
    points = camera.data.pos_w.double().numpy()[:, None, None] + depth[..., None] * (
        rays @ turn.swapaxes(1, 2)[:, None]
    )
    u, v = ((points[..., i] - field.lower[i]) / field.cell[i] for i in range(2))
    heights = field.heights.numpy()
    column, row = (np.clip(np.nan_to_num(w, posinf=0.0), 0, n - 2).astype(int) for w, n in zip((u, v), heights.T.shape))
    around = np.stack([heights[row + i, column + j] for i in (0, 1) for j in (0, 1)])
    inside = (points[..., 2] > around.min(axis=0) - 0.01) & (points[..., 2] < around.max(axis=0) + 0.01)
    assert shown.mean() > 0.3
    assert inside[shown].mean() > 0.97  # the rest are the robot's own legs
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("task", [FOREST, FOREST.replace("-v0", "-Play-v0")])
def test_the_camera_sees_the_forest(task):
    env = gymnasium.make_vec(task, cfg=small_cfg(task, 16))
    obs, _ = env.reset(seed=1)
    for _ in range(5):
        obs, *_ = env.step(torch.zeros(16, 12))
    camera = env.unwrapped.scene["depth_camera"]
    seen = (obs["depth"] < 1.0).float().mean(dim=(1, 2, 3))
    assert (seen > 0.2).all()
    assert camera.data.output["distance_to_image_plane"].shape == (16, 48, 64, 1)
    env.close()
