# SPDX-License-Identifier: Apache-2.0
"""Training specifications: a scene coupled with a task."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch

from stripe_newton.cli.tasks import load_cfg, task_ids
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import ObservationGroupCfg, ObservationTermCfg, RewardTermCfg, TerminationTermCfg
from stripe_newton.sensors import ContactSensorCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.specifications import (
    CylinderMesh,
    IdenticalAssetSpec,
    SceneSpec,
    SceneStageCfg,
    TerrainInstance,
    TrainingSpec,
)
from stripe_newton.terrains import Ground
from stripe_tasks.robots import ANT_CFG


@configclass
class PolicyCfg(ObservationGroupCfg):
    height: ObservationTermCfg = ObservationTermCfg(func=mdp.base_pos_z)


class Posts(IdenticalAssetSpec):
    def find_positions(self, terrain, rng):
        angle = rng.uniform(-np.pi, np.pi, 8)
        return 3.0 * np.column_stack([np.cos(angle), np.sin(angle)])


class Bumps(SceneSpec):
    def generate(self, rng):
        return TerrainInstance(Ground(rng.uniform(0.0, 0.2, (17, 17)), (-4.0, -4.0), (0.5, 0.5)))


class Hollow(SceneSpec):
    def generate(self, rng):
        x = np.linspace(-1.0, 1.0, 17)
        return TerrainInstance(Ground(x[None] ** 2 + x[:, None] ** 2 - 2.0, (-4.0, -4.0), (0.5, 0.5)))


@pytest.fixture
def training():
    return TrainingSpec(
        scene=Bumps((8.0, 8.0), [Posts("posts", CylinderMesh("post", (0.1, 0.5)))]),
        robot=ANT_CFG,
        observations={"policy": PolicyCfg()},
        actions={"efforts": mdp.JointEffortActionCfg(joint_names=[".*"], scale=5.0)},
        rewards={"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)},
        terminations={"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)},
        sensors={"contacts": ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*")},
        sim=SimulationCfg(device="cpu", dt=1 / 120, solver=MuJoCoSolverCfg(njmax=300, nconmax=60)),
        num_envs=2,
        env_spacing=1.0,
    )


def test_scene_and_task_become_an_environment_by_name(training):
    cfg = training.to_env_cfg(decimation=2, episode_length_s=1.0, seed=3)
    name = cfg.register("Test-Spec-Ant-v0")
    try:
        assert name in task_ids()
        assert load_cfg(name, "env").scene.scenery.spawn.seed == 3
        env = gymnasium.make_vec(name, num_envs=3)
        inner = env.unwrapped
        assert inner.num_envs == 3
        expected = training.scene.create(3).terrain.ground.heights
        np.testing.assert_array_equal(inner.scene.terrain.ground.heights, expected)
        assert sum(label.startswith("/World/posts") for label in inner.sim.model.shape_label) == 16
        env.reset(seed=0)
        for _ in range(20):
            obs, reward, *_ = env.step(torch.zeros(3, inner.single_action_space.shape[0]))
        assert torch.isfinite(obs["policy"]).all()
        assert (reward > 0).all()
        assert "contacts" in inner.scene.sensors
        env.close()
    finally:
        gymnasium.registry.pop(name, None)


def test_a_scene_is_swapped_without_touching_the_task(training):
    one, other = training.to_env_cfg(), replace(training, scene=Hollow((8.0, 8.0))).to_env_cfg()
    assert one.rewards == other.rewards
    grounds = [cfg.scene.scenery.spawn.made().terrain.ground.heights for cfg in (one, other)]
    assert grounds[0].min() >= 0.0 > grounds[1].min()


def test_a_scene_is_made_once_for_a_seed(training):
    cfg = training.to_env_cfg(seed=5)
    assert cfg.scene.scenery.spawn.made() is cfg.copy().scene.scenery.spawn.made()
    other = cfg.copy()
    other.scene.scenery.spawn.seed = 6
    assert other.scene.scenery.spawn.made() is not cfg.scene.scenery.spawn.made()


def test_what_is_wrong_is_said(training):
    with pytest.raises(ValueError, match="has 'contacts' already"):
        replace(training, assets={"contacts": ANT_CFG}).to_env_cfg()
    with pytest.raises(ConfigError, match="give either a SceneSpec or the usd_path"):
        SceneStageCfg().validate()
