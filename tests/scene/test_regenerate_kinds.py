# SPDX-License-Identifier: Apache-2.0
"""Regeneration with other solvers, other kinds of environments, tiles and pictures."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg, ManagerBasedRLEnv
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg, XPBDSolverCfg
from stripe_newton.specifications import TileGridSpec
from stripe_tasks.robots import ANT_CFG
from tests.helpers.regenerate_world import Hills, N, Posts, make, scanner, training


def test_pictures_show_the_new_scene():
    cfg = training().to_env_cfg(seed=3)
    cfg.viewer.resolution, cfg.viewer.eye, cfg.viewer.lookat = (48, 32), (9.0, 9.0, 6.0), (0.0, 0.0, 0.0)
    cfg.viewer.origin_type = "world"
    env = ManagerBasedRLEnv(cfg, "rgb_array")
    env.reset()
    before = env.render().astype(int)
    env.regenerate(7)
    after = env.render().astype(int)
    env.regenerate(3)
    again = env.render().astype(int)
    assert np.abs(before - after).max() > 30
    assert np.abs(before - again).mean() < 0.2 * np.abs(before - after).mean()


@pytest.mark.parametrize(
    "solver",
    [
        MuJoCoSolverCfg(njmax=400, nconmax=80, use_mujoco_cpu=True),
        XPBDSolverCfg(),
    ],
    ids=["mujoco_cpu", "xpbd"],
)
def test_other_ways_of_contact_find_the_new_ground(solver):
    sim = SimulationCfg(device="cpu", dt=1 / 240, solver=solver)
    options = {"obstacles": None, "sensors": {"scanner": scanner()}, "sim": sim, "num_envs": 1}
    env = make(3, training(Hills(palette=[]), **options))
    old = env.scene.terrain.ground
    env.regenerate(11)
    new = env.scene.terrain.ground
    heights = []
    for _ in range(75):
        env.step(torch.zeros(1, 8))
        pos = env.scene["robot"].data.body_pos_w[0, :, :3].numpy()
        heights.append([(pos[:, 2] - g.height_at(pos[:, 0], pos[:, 1])).min() for g in (old, new)])
    assert abs(heights[-1][0] - heights[-1][1]) > 0.4
    assert 0.0 < heights[-1][1] < 0.6


class Roamer(DirectRLEnv):
    """Starts in the middle of the terrain, at its height."""

    def _setup_scene(self):
        self.scene.clone_environments()

    def _pre_physics_step(self, actions):
        self.actions = actions

    def _apply_action(self):
        pass

    def _get_dones(self):
        late = self.episode_length_buf >= self.max_episode_length
        return torch.zeros_like(late), late

    def _get_rewards(self):
        return torch.zeros(self.num_envs)

    def _reset_idx(self, env_ids):
        super()._reset_idx(env_ids)
        robot = self.scene["robot"]
        state = robot.data.default_root_state[env_ids].clone()
        state[:, :3] += self.scene.env_origins[env_ids]
        robot.write_root_pose_to_sim(state[:, :7], env_ids)

    def _get_observations(self):
        return {"policy": self.scene["robot"].data.root_pos_w[:, 2:3].clone()}


@configclass
class RoamerCfg(DirectRLEnvCfg):
    decimation = 2
    episode_length_s = 1.0
    observation_space = 1
    action_space = 8


def test_a_direct_environment_goes_on_in_another_scene():
    spec = training(Hills(places=False))
    factory = spec.scene.create_instance(N, 0.5, seed=3)
    factory.add_sensor("obstacles", ObstaclesCfg(of_scenery=True, reach=1.2))
    env = Roamer(RoamerCfg(sim=spec.sim, scene=factory.get_scene(ANT_CFG)))
    env.reset()
    for _ in range(3):
        env.step(torch.zeros(N, 8))
    assert (env.episode_length_buf == 3).all()
    env.regenerate(11)
    assert (env.episode_length_buf == 0).all()
    ground, at = env.scene.terrain.ground, env.scene.env_origins.numpy()
    np.testing.assert_allclose(at[:, 2], ground.height_at(at[:, 0], at[:, 1]), atol=1e-5)
    start = ANT_CFG.init_state.pos[2]
    np.testing.assert_allclose(env.obs_buf["policy"][:, 0], at[:, 2] + start, atol=1e-5)
    env.step(torch.zeros(N, 8))


def test_levels_of_tiles_stay():
    posts = Posts(count=5)
    tiles = TileGridSpec([Hills((8.0, 8.0), [posts]), Hills((8.0, 8.0), [posts])], types=2, fade=1.0, border=1.0)
    env = make(3, training(tiles, sensors={"scanner": scanner()}))
    terrain = env.scene.terrain
    terrain.terrain_levels[:] = torch.tensor([1, 1, 0, 1])
    old = terrain.terrain_origins.clone()
    env.scene.regenerate(5)
    assert terrain.terrain_levels.tolist() == [1, 1, 0, 1]
    assert not torch.equal(old, terrain.terrain_origins)
    assert torch.equal(
        env.scene.env_origins, terrain.terrain_origins[terrain.terrain_levels.long(), terrain.terrain_types.long()]
    )
    assert env.sim.env_origin.ptr == env.scene.env_origins.data_ptr()
