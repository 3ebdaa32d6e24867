# SPDX-License-Identifier: Apache-2.0
"""Environment class as users of Isaac Lab's direct workflow write it: only its imports are of this project."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
import torch

import stripe_newton.sim as sim_utils
from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.math import sample_uniform
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import GroundPlaneCfg, SimulationCfg, spawn_ground_plane
from stripe_tasks.robots import CARTPOLE_CFG


@configclass
class CartpoleEnvCfg(DirectRLEnvCfg):
    # environment
    decimation = 2
    episode_length_s = 0.5
    action_scale = 100.0
    action_space = 1
    observation_space = 4
    state_space = 0

    # physics
    sim: SimulationCfg = SimulationCfg(dt=1 / 120, render_interval=decimation)

    # robot
    robot_cfg: ArticulationCfg = CARTPOLE_CFG.replace(prim_path="/World/envs/env_.*/Robot")
    cart_dof_name = "slider_to_cart"
    pole_dof_name = "cart_to_pole"

    # environments
    scene: InteractiveSceneCfg = InteractiveSceneCfg(
        num_envs=8, env_spacing=4.0, replicate_physics=True, clone_in_fabric=True
    )

    # episodes and rewards
    max_cart_pos = 3.0
    initial_pole_angle_range = [-0.25, 0.25]
    rew_scale_alive = 1.0
    rew_scale_terminated = -2.0
    rew_scale_pole_pos = -1.0
    rew_scale_cart_vel = -0.01
    rew_scale_pole_vel = -0.005


class CartpoleEnv(DirectRLEnv):
    cfg: CartpoleEnvCfg

    def __init__(self, cfg: CartpoleEnvCfg, render_mode: str | None = None, **kwargs):
        super().__init__(cfg, render_mode, **kwargs)

        self._cart_dof_idx, _ = self.cartpole.find_joints(self.cfg.cart_dof_name)
        self._pole_dof_idx, _ = self.cartpole.find_joints(self.cfg.pole_dof_name)
        self.action_scale = self.cfg.action_scale

        self.joint_pos = self.cartpole.data.joint_pos
        self.joint_vel = self.cartpole.data.joint_vel

    def _setup_scene(self):
        self.cartpole = Articulation(self.cfg.robot_cfg)
        spawn_ground_plane(prim_path="/World/ground", cfg=GroundPlaneCfg())
        self.scene.clone_environments(copy_from_source=False)
        if self.device == "cpu":
            self.scene.filter_collisions(global_prim_paths=[])
        self.scene.articulations["cartpole"] = self.cartpole
        light_cfg = sim_utils.DomeLightCfg(intensity=2000.0, color=(0.75, 0.75, 0.75))
        light_cfg.func("/World/Light", light_cfg)

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        self.actions = self.action_scale * actions.clone()

    def _apply_action(self) -> None:
        self.cartpole.set_joint_effort_target(self.actions, joint_ids=self._cart_dof_idx)

    def _get_observations(self) -> dict:
        obs = torch.cat(
            (
                self.joint_pos[:, self._pole_dof_idx[0]].unsqueeze(dim=1),
                self.joint_vel[:, self._pole_dof_idx[0]].unsqueeze(dim=1),
                self.joint_pos[:, self._cart_dof_idx[0]].unsqueeze(dim=1),
                self.joint_vel[:, self._cart_dof_idx[0]].unsqueeze(dim=1),
            ),
            dim=-1,
        )
        observations = {"policy": obs}
        return observations

    def _get_rewards(self) -> torch.Tensor:
        total_reward = compute_rewards(
            self.cfg.rew_scale_alive,
            self.cfg.rew_scale_terminated,
            self.cfg.rew_scale_pole_pos,
            self.cfg.rew_scale_cart_vel,
            self.cfg.rew_scale_pole_vel,
            self.joint_pos[:, self._pole_dof_idx[0]],
            self.joint_vel[:, self._pole_dof_idx[0]],
            self.joint_vel[:, self._cart_dof_idx[0]],
            self.reset_terminated,
        )
        return total_reward

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        self.joint_pos = self.cartpole.data.joint_pos
        self.joint_vel = self.cartpole.data.joint_vel

        time_out = self.episode_length_buf >= self.max_episode_length - 1
        out_of_bounds = torch.any(torch.abs(self.joint_pos[:, self._cart_dof_idx]) > self.cfg.max_cart_pos, dim=1)
        out_of_bounds = out_of_bounds | torch.any(torch.abs(self.joint_pos[:, self._pole_dof_idx]) > math.pi / 2, dim=1)
        return out_of_bounds, time_out

    def _reset_idx(self, env_ids: Sequence[int] | None):
        if env_ids is None:
            env_ids = self.cartpole._ALL_INDICES
        super()._reset_idx(env_ids)

        joint_pos = self.cartpole.data.default_joint_pos[env_ids]
        joint_pos[:, self._pole_dof_idx] += sample_uniform(
            self.cfg.initial_pole_angle_range[0] * math.pi,
            self.cfg.initial_pole_angle_range[1] * math.pi,
            joint_pos[:, self._pole_dof_idx].shape,
            joint_pos.device,
        )
        joint_vel = self.cartpole.data.default_joint_vel[env_ids]

        default_root_state = self.cartpole.data.default_root_state[env_ids]
        default_root_state[:, :3] += self.scene.env_origins[env_ids]

        self.joint_pos[env_ids] = joint_pos
        self.joint_vel[env_ids] = joint_vel

        self.cartpole.write_root_pose_to_sim(default_root_state[:, :7], env_ids)
        self.cartpole.write_root_velocity_to_sim(default_root_state[:, 7:], env_ids)
        self.cartpole.write_joint_state_to_sim(joint_pos, joint_vel, None, env_ids)


@torch.jit.script
def compute_rewards(
    rew_scale_alive: float,
    rew_scale_terminated: float,
    rew_scale_pole_pos: float,
    rew_scale_cart_vel: float,
    rew_scale_pole_vel: float,
    pole_pos: torch.Tensor,
    pole_vel: torch.Tensor,
    cart_vel: torch.Tensor,
    reset_terminated: torch.Tensor,
):
    rew_alive = rew_scale_alive * (1.0 - reset_terminated.float())
    rew_termination = rew_scale_terminated * reset_terminated.float()
    rew_pole_pos = rew_scale_pole_pos * torch.sum(torch.square(pole_pos).unsqueeze(dim=1), dim=-1)
    rew_cart_vel = rew_scale_cart_vel * torch.sum(torch.abs(cart_vel).unsqueeze(dim=1), dim=-1)
    rew_pole_vel = rew_scale_pole_vel * torch.sum(torch.abs(pole_vel).unsqueeze(dim=1), dim=-1)
    total_reward = rew_alive + rew_termination + rew_pole_pos + rew_cart_vel + rew_pole_vel
    return total_reward


# -- the tests


def make(device: str = "cpu", cls: type[CartpoleEnv] = CartpoleEnv) -> CartpoleEnv:
    cfg = CartpoleEnvCfg()
    cfg.sim.device = device
    return cls(cfg)


def test_fields_without_annotation_are_fields():
    cfg = CartpoleEnvCfg()
    assert {"decimation", "action_scale", "initial_pole_angle_range"} <= set(CartpoleEnvCfg.__dataclass_fields__)
    assert cfg.sim.render_interval == 2
    assert CartpoleEnvCfg().initial_pole_angle_range is not cfg.initial_pole_angle_range


def test_a_hundred_random_steps(device):
    env = make(device)
    generator = torch.Generator(env.device).manual_seed(0)
    obs, _ = env.reset(seed=1)
    assert (env.num_envs, env.max_episode_length) == (8, 30)
    angle = obs["policy"][:, 0]
    assert angle.abs().max() <= math.pi / 4
    assert len(angle.unique()) == 8
    assert not obs["policy"][:, 1:].any()
    ended = torch.zeros(8, device=env.device)
    failed = 0
    for _ in range(100):
        lengths = env.episode_length_buf.clone()
        obs, reward, terminated, truncated, _ = env.step(torch.randn(8, 1, generator=generator, device=env.device))
        done = terminated | truncated
        assert torch.isfinite(obs["policy"]).all()
        assert torch.equal(truncated, lengths + 1 >= 29)
        assert torch.equal(env.episode_length_buf, torch.where(done, 0, lengths + 1))
        assert (reward[terminated] <= -2.0).all()
        assert (reward[~terminated] <= 1.0).all()
        assert not obs["policy"][done][:, 1:].any()
        assert (obs["policy"][done][:, 0].abs() <= math.pi / 4).all()
        ended += done
        failed += int(terminated.sum())
    assert (ended >= 3).all()
    assert failed > 0
    origins = env.cartpole.data.root_pos_w - env.scene.env_origins
    torch.testing.assert_close(
        origins, torch.tensor([0.0, 0.0, 2.0], device=env.device).expand(8, 3), atol=1e-5, rtol=0
    )


def test_rewards_are_the_formula():
    env = make()
    env.reset(seed=2)
    env.episode_length_buf[:] = -1000
    for _ in range(40):
        obs, reward, terminated, *_ = env.step(torch.full((8, 1), 0.3))
        going = ~terminated
        pole, rate, _, speed = obs["policy"][going].double().unbind(-1)
        expected = 1.0 - pole**2 - 0.01 * speed.abs() - 0.005 * rate.abs()
        torch.testing.assert_close(reward[going].double(), expected, atol=1e-5, rtol=0.0)


def test_writing_the_root_pose_unchanged_changes_nothing():
    class Without(CartpoleEnv):
        def _reset_idx(self, env_ids):
            DirectRLEnv._reset_idx(self, env_ids)
            joint_pos = self.cartpole.data.default_joint_pos[env_ids]
            joint_pos[:, self._pole_dof_idx] += sample_uniform(
                -0.25 * math.pi, 0.25 * math.pi, joint_pos[:, self._pole_dof_idx].shape, joint_pos.device
            )
            self.joint_pos[env_ids] = joint_pos
            self.joint_vel[env_ids] = self.cartpole.data.default_joint_vel[env_ids]

    results = []
    for cls in (CartpoleEnv, Without):
        env = make(cls=cls)
        env.reset(seed=3)
        results.append(torch.stack([env.step(torch.full((8, 1), 0.2))[0]["policy"] for _ in range(60)]))
    assert torch.equal(*results)


def test_it_renders():
    pytest.importorskip("PIL")
    env = CartpoleEnv(make().cfg, render_mode="rgb_array")
    env.reset(seed=1)
    picture = env.render()
    assert picture.ndim == 3
    assert picture.shape[-1] == 3
    assert picture.std() > 5.0
    env.close()
