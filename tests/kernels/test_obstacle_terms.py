# SPDX-License-Identifier: Apache-2.0
"""Obstacle terms, against float64 references computed in other ways, and in an environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels import obstacles as kernels
from stripe_kernels.mdp.obstacles import obstacle_distance
from stripe_kernels.sensors.ray import RayCasterData
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.scene import Capsules, ObstaclesCfg
from stripe_newton.sim import (
    MuJoCoSolverCfg,
    SimulationCfg,
)
from tests.helpers import term_kernels as tk
from tests.helpers.obstacle_world import (
    REACH,
    WalkCfg,
    ball_scene,
    distances,
    random_capsules,
)


@wp.kernel(enable_backward=False)
def observe(obstacles: kernels.ObstacleData, threshold: float, out: wp.array2d[float], close: wp.array[wp.bool]):
    env = wp.tid()
    mdp.obstacle_distance(env, obstacles, out[env])
    close[env] = mdp.obstacle_too_close(env, obstacles, threshold)


def test_terms_see_what_is_near():
    capsules = random_capsules(100, 7)
    scene = ball_scene(capsules, num_envs=12, slots=4)
    rng = np.random.default_rng(8)
    points = (rng.uniform(-5, 5, (12, 3)) * [1, 1, 0.1]).astype(np.float32)
    yaw = rng.uniform(-3, 3, 12)
    pose = np.column_stack([points, 0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)]).astype(np.float32)
    scene["robot"].write_root_pose_to_sim(torch.from_numpy(pose))
    sensor = scene["obstacles"]
    sensor.update(0.0)
    out, close = wp.zeros((12, 16), dtype=float, device="cpu"), wp.zeros(12, dtype=wp.bool, device="cpu")
    wp.launch(observe, dim=12, inputs=[sensor.struct, 0.4], outputs=[out, close], device="cpu")
    found, some = out.numpy().reshape(12, 4, 4), 0
    for env in range(12):
        wanted = distances(capsules, points[env])
        assert bool(close.numpy()[env]) == (wanted.min() < 0.4)
        for slot, i in enumerate(sensor.data.index[env].tolist()):
            point, distance = found[env, slot, :3].astype(np.float64), found[env, slot, 3]
            if i < 0:
                np.testing.assert_array_equal(found[env, slot], np.array([0, 0, 0, REACH], dtype=np.float32))
                continue
            some += 1
            assert distance == pytest.approx(wanted[i], abs=3e-6)
            assert np.linalg.norm(point) == pytest.approx(abs(wanted[i]), abs=3e-6)
            c, s = np.cos(yaw[env]), np.sin(yaw[env])
            world = points[env] + np.array([c * point[0] - s * point[1], s * point[0] + c * point[1], point[2]])
            assert distances(capsules, world)[i] == pytest.approx(0.0, abs=1e-5)  # it lies on the surface
    assert some > 10
    assert 0 < close.numpy().sum() < 12
    assert tk.size_of(obstacle_distance, sensor.counts) == 16


@wp.kernel(enable_backward=False)
def look(obstacles: kernels.ObstacleData, directions: wp.array[int], below: float, out: wp.array2d[float]):
    env = wp.tid()
    mdp.obstacle_proximity(env, obstacles, directions, below, out[env])


@wp.kernel(enable_backward=False)
def scan(obstacles: kernels.ObstacleData, sensor: RayCasterData, rays: wp.array[int], out: wp.array2d[float]):
    env = wp.tid()
    mdp.height_scan_over(env, sensor, obstacles, rays, out[env], 0.3)


def looking(num_envs: int = 16, slots: int = 6):
    """Robots somewhere among obstacles, the obstacles that they found, and where the robots are."""
    capsules = random_capsules(150, 11, longest=3.0)
    scene = ball_scene(capsules, num_envs=num_envs, slots=slots, reach=0.01, sight=REACH, directions=24)
    rng = np.random.default_rng(12)
    pose = np.zeros((num_envs, 7), dtype=np.float32)
    pose[:, :3] = rng.uniform(-5, 5, (num_envs, 3)) * [1, 1, 0.1]
    yaw = rng.uniform(-3, 3, num_envs)
    pose[:, 5], pose[:, 6] = np.sin(yaw / 2), np.cos(yaw / 2)
    scene["robot"].write_root_pose_to_sim(torch.from_numpy(pose))
    scene["obstacles"].update(0.0)
    return capsules, scene["obstacles"], pose.astype(float), yaw


def outlines(capsules: Capsules, found: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends of the axes ``(N, 2, 3)``, radii and heights of the tops of capsules, float64."""
    rot = Rotation.from_quat(capsules.rotations[found].astype(float))
    axis = rot.apply([0.0, 0.0, 1.0]) * capsules.half_length[found].astype(float)[:, None]
    ends = capsules.positions[found].astype(float)[:, None] + np.stack([-axis, axis], axis=1)
    radius = capsules.radius[found].astype(float)
    return ends, radius, ends[..., 2].max(axis=1) + radius


@pytest.mark.parametrize("below", [0.1, -10.0, 10.0])
def test_proximity_is_that_of_rays_seen_from_above(below):
    capsules, sensor, pose, yaw = looking()
    out = wp.zeros((16, 24), dtype=float, device="cpu")
    inputs = [sensor.struct, wp.array(np.arange(24), dtype=int, device="cpu"), below]
    wp.launch(look, dim=16, inputs=inputs, outputs=[out], device="cpu")
    seen = 0
    for env in range(16):
        found = [i for i in sensor.data.index[env].tolist() if i >= 0]
        ends, radius, top = outlines(capsules, found)
        radius = radius + np.maximum(distances(capsules, pose[env, :3])[found], 0.0) * np.tan(np.pi / 24)
        ends, radius = (v[top > pose[env, 2] - below] for v in (ends, radius))
        for k in range(24):
            angle, way = yaw[env] + 2.0 * np.pi * k / 24, 0.0
            while way < REACH and len(ends):  # sphere tracing
                point = pose[env, :2] + way * np.array([np.cos(angle), np.sin(angle)])
                a, b = ends[:, 0, :2], ends[:, 1, :2]
                t = np.clip(((point - a) * (b - a)).sum(axis=1) / np.maximum(((b - a) ** 2).sum(axis=1), 1e-12), 0, 1)
                away = (np.linalg.norm(point - a - t[:, None] * (b - a), axis=1) - radius).min()
                if away < 1e-7:
                    break
                way += away
            wanted = max(0.0, 1.0 - way / REACH) if len(ends) else 0.0
            seen += 0.0 < wanted < 1.0
            assert out.numpy()[env, k] == pytest.approx(wanted, abs=2e-4)
    assert (seen > 40) == (below > -5.0)


def test_a_height_scan_has_the_obstacles_on_the_ground():
    capsules, sensor, pose, _ = looking()
    rays, rng = 60, np.random.default_rng(13)
    hits = np.concatenate([pose[:, None, :2] + rng.uniform(-1, 1, (16, rays, 2)), np.full((16, rays, 1), -0.4)], axis=2)
    data = RayCasterData()
    data.pos_w = wp.array(pose[:, :3].astype(np.float32), dtype=wp.vec3)
    data.ray_hits_w = wp.array(hits.astype(np.float32), dtype=wp.vec3)
    out, ids = wp.zeros((16, rays), dtype=float, device="cpu"), wp.array(np.arange(rays), dtype=int)
    wp.launch(scan, dim=16, inputs=[sensor.struct, data, ids], outputs=[out], device="cpu")
    over = 0
    for env in range(16):
        found = [i for i in sensor.data.index[env].tolist() if i >= 0]
        ends, radius, _ = outlines(capsules, found)
        t = np.linspace(0.0, 1.0, 20001)
        for ray in range(rays):
            top = -0.4
            for (a, b), r in zip(ends, radius, strict=True):
                inside = r**2 - ((a[:2] + t[:, None] * (b - a)[:2] - hits[env, ray, :2]) ** 2).sum(axis=1)
                if (inside >= 0.0).any():
                    top = max(top, (a[2] + t * (b - a)[2] + np.sqrt(np.maximum(inside, 0.0)))[inside >= 0.0].max())
            over += top > -0.4
            assert out.numpy()[env, ray] == pytest.approx(pose[env, 2] - top - 0.3, abs=2e-3)
    assert over > 50


@configclass
class PolicyCfg(ObservationGroupCfg):
    """Observations of the policy."""

    near: ObservationTermCfg = ObservationTermCfg(func=mdp.obstacle_distance)


@configclass
class EnvCfg(ManagerBasedRLEnvCfg):
    """A trunk stands beside the robot of one environment of two, whose episodes end at once."""

    decimation: int = 2
    episode_length_s: float = 10.0
    seed: int | None = 3
    sim: SimulationCfg = SimulationCfg(device="cpu", dt=0.005, solver=MuJoCoSolverCfg(njmax=60, nconmax=16))
    scene: WalkCfg = WalkCfg(
        num_envs=2,
        env_spacing=4.0,
        obstacles=ObstaclesCfg(positions=[[0.0, 0.6, 0.2]], radius=0.1, half_length=0.3, slots=2, reach=1.0),
    )
    observations: Any = {"policy": PolicyCfg()}
    actions: Any = {"joint_pos": mdp.JointPositionActionCfg(asset_name="robot", joint_names=[".*"], scale=0.25)}
    rewards: Any = {"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)}
    terminations: Any = {
        "close": TerminationTermCfg(func=mdp.obstacle_too_close, params={"threshold": 0.9}),
    }
    events: Any = {"base": EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")}


def test_an_environment_takes_the_terms_by_their_types(device):
    cfg = EnvCfg()
    cfg.sim.device = device
    env = ManagerBasedRLEnv(cfg)
    obs, _ = env.reset()
    origins = env.scene.env_origins.cpu().numpy()
    near = np.abs(origins).max(axis=1) < 0.5
    assert near.tolist().count(True) == 1
    sensor = env.scene["obstacles"]
    for _ in range(3):
        obs, _, terminated, _, _ = env.step(torch.zeros(2, env.action_manager.total_action_dim, device=device))
        assert terminated.tolist() == near.tolist()
        seen = obs["policy"].cpu().numpy().reshape(2, 2, 4)
        roots = env.scene["robot"].data.root_pos_w.cpu().numpy()  # of the new episode where one began
        wanted = [distances(sensor.capsules, root)[0] for root in roots]
        np.testing.assert_allclose(seen[near, 0, 3], np.array(wanted)[near], atol=1e-5)
        np.testing.assert_array_equal(seen[~near, 0, 3], np.float32(1.0))
        np.testing.assert_array_equal(seen[:, 1], np.tile(np.float32([0, 0, 0, 1.0]), (2, 1)))
    env.close()
