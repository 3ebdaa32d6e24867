# SPDX-License-Identifier: Apache-2.0
"""Regeneration that is refused: scenes that cannot change, and their errors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stripe_newton.assets import AssetBaseCfg
from stripe_newton.configclass import ConfigError
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.rl import OnPolicyRunner, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg, RslRlVecEnvWrapper
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.scene.scenery import read_scenery
from stripe_newton.sensors import CameraCfg
from stripe_newton.sim import CapsuleCfg, CollisionPropertiesCfg
from stripe_newton.specifications import BoxMesh, CylinderMesh
from tests.helpers.cart_env import make as make_cart
from tests.helpers.regenerate_world import Hills, N, Posts, make, scanner, small_hills, training


@pytest.fixture(scope="module")
def ordinary():
    """Posts that are shapes of the model."""
    return make(3, training(small_hills(), obstacles=None, sensors={"scanner": scanner()}))


def refused(env, match, seed=5):
    heights = env.scene.terrain.struct.heights.numpy()
    stage = env.scene.stage.GetRootLayer().ExportToString()
    with pytest.raises(ValueError, match=match):
        env.regenerate(seed)
    np.testing.assert_array_equal(env.scene.terrain.struct.heights.numpy(), heights)
    assert env.scene.stage.GetRootLayer().ExportToString() == stage
    assert env.scene.scenery_seed == 3
    env.step(torch.zeros(N, 8))


def test_ordinary_colliders_are_refused(ordinary):
    refused(ordinary, r"set TrainingSpec\(obstacles=ObstaclesCfg\(\.\.\.\)\)")


def test_another_grid_is_refused():
    spec = Hills((8.0, 8.0), [Posts(count=5)], places=False, grows=1)
    refused(
        make(3, training(spec, events=None, sensors={"scanner": scanner()})),
        r"seed 5: '/World/ground': the new ground has heights",
    )


def test_too_many_obstacles_name_the_number():
    spec = Hills(palette=[Posts(count=5, spread=300)])
    counts = [len(read_scenery(spec.create(s).stage).paths) for s in (3, 5)]
    more = counts[1] > counts[0]
    seeds = (3, 5) if more else (5, 3)
    count = max(counts)
    room = ObstaclesCfg(slots=12, reach=1.2, capacity=count - 1)
    env = make(seeds[0], training(spec, obstacles=room))
    with pytest.raises(ValueError, match=rf"{count} obstacles do not fit, set ObstaclesCfg\(capacity={count}\)"):
        env.regenerate(seeds[1])


def test_boxes_among_obstacles_are_refused():
    class Sometimes(Posts):
        def generate(self, terrain, rng):
            self.mesh = BoxMesh("box", (0.2, 0.2, 0.2)) if terrain.kind else CylinderMesh("post", (0.15, 1.0))
            return super().generate(terrain, rng)

    class Boxes(Hills):
        def generate(self, rng):
            terrain = super().generate(rng)
            terrain.kind = self.kind
            return terrain

    spec = Boxes(palette=[Sometimes()])
    spec.kind = False
    env = make(3, training(spec))
    spec.kind = True
    with pytest.raises(ValueError, match="is a box, which no capsule stands for"):
        env.regenerate(5)


def test_cameras_are_refused():
    camera = CameraCfg(prim_path="{ENV_REGEX_NS}/Robot/torso/cam", width=8, height=8)
    spec = training(small_hills(), sensors={"scanner": scanner(), "eye": camera})
    refused(make(3, spec), "the camera 'eye' sees the meshes")


def test_what_is_fixed_in_the_environments_is_refused():
    table = AssetBaseCfg(
        prim_path="{ENV_REGEX_NS}/Table",
        spawn=CapsuleCfg(radius=0.1, height=0.2, collision_props=CollisionPropertiesCfg()),
    )
    env = make(3, training(small_hills(), assets={"table": table}, sensors={"scanner": scanner()}))
    refused(env, r"'/World/envs/env_0/Table.*' is fixed to the world in each environment")


def test_a_scene_of_a_file_is_refused(tmp_path):
    file = small_hills().create(3).export(tmp_path / "hills.usda")
    cfg = training().to_env_cfg(seed=3)
    cfg.scene.scenery.spawn = cfg.scene.scenery.spawn.replace(spec=None, usd_path=str(file))
    env = ManagerBasedRLEnv(cfg)
    with pytest.raises(ValueError, match=r"is of the file '.*hills\.usda'"):
        env.regenerate(5)


def test_a_scene_without_a_specification_is_refused():
    with pytest.raises(ValueError, match="the scene is of no specification"):
        make_cart().regenerate(1)
    scene = make_cart().scene
    with pytest.deprecated_call(match="why_not_regenerable"):
        assert scene.obstacle_to_regenerating() == scene.why_not_regenerable() != ""


def test_training_says_at_its_start_that_it_cannot(ordinary):
    env = RslRlVecEnvWrapper(ordinary)
    agent = RslRlOnPolicyRunnerCfg(regenerate_interval=2, algorithm=RslRlPpoAlgorithmCfg(num_mini_batches=1))
    with pytest.raises(ConfigError, match=r"regenerate_interval: is 2, but assets like '.*' have colliders"):
        OnPolicyRunner(env, agent)
    with pytest.raises(ConfigError, match="regenerate_interval: is -1"):
        RslRlOnPolicyRunnerCfg(regenerate_interval=-1).validate()
