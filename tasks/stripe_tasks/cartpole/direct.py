# SPDX-License-Identifier: Apache-2.0
"""Direct cart-pole in torch: ``Stripe-Cartpole-Direct-v0``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import torch

from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.math import sample_uniform
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_tasks.robot_scene import spawn_scenery
from stripe_tasks.robots import CARTPOLE_CFG

__all__ = ["CartpoleEnv", "CartpoleEnvCfg", "CartpolePPORunnerCfg"]


@configclass
class CartpoleEnvCfg(DirectRLEnvCfg):
    """Direct cart-pole.

    The pole starts within 45 degrees of upright. An episode ends when it falls, when the cart is too far out, or after
    5 s.
    """

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ("action_space", "observation_space")

    decimation: int = 2
    episode_length_s: float = 5.0
    action_space: int = 1
    observation_space: int = 4
    sim: SimulationCfg = SimulationCfg(
        dt=1.0 / 120.0,
        render_interval=2,
        solver=MuJoCoSolverCfg(disable_contacts=True),  # cart and pole can touch nothing
    )
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=512, env_spacing=4.0)
    robot: ArticulationCfg = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    cart_joint: str = "slider_to_cart"
    """Name of the driven joint."""
    pole_joint: str = "cart_to_pole"
    """Name of the pole's joint."""
    action_scale: float = 100.0
    """Force for an action of one [N]."""
    max_cart_pos: float = 3.0
    """Distance from the middle of the rail at which an episode ends [m]."""
    initial_pole_angle: float = 0.25 * math.pi
    """Largest pole angle at the start [rad]."""
    rew_alive: float = 1.0
    """Reward of a step in which the pole is up."""
    rew_terminated: float = -2.0
    """Reward for ending the episode before its full length."""
    rew_pole_pos: float = -1.0
    """Weight of the squared pole angle."""
    rew_cart_vel: float = -0.01
    """Weight of the cart's speed."""
    rew_pole_vel: float = -0.005
    """Weight of the pole's angular speed."""


class CartpoleEnv(DirectRLEnv):
    """Balance a pole on a cart.

    Observations: pole angle [rad], its rate, cart position [m], its rate. Action: force on the cart.
    """

    cfg: CartpoleEnvCfg

    def __init__(self, cfg: CartpoleEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        self._cart = self.robot.find_joints(cfg.cart_joint)[0][0]
        self._pole = self.robot.find_joints(cfg.pole_joint)[0][0]
        # views of the simulation's state: read anew in each hook, they are never stale
        self.joint_pos = self.robot.data.joint_pos
        self.joint_vel = self.robot.data.joint_vel

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        spawn_scenery()
        self.scene.clone_environments(copy_from_source=False)

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        self.actions = self.cfg.action_scale * actions

    def _apply_action(self) -> None:
        self.robot.set_joint_effort_target(self.actions, joint_ids=[self._cart])

    def _get_observations(self) -> dict[str, torch.Tensor]:
        pole, cart = self._pole, self._cart
        columns = (self.joint_pos[:, pole], self.joint_vel[:, pole], self.joint_pos[:, cart], self.joint_vel[:, cart])
        return {"policy": torch.stack(columns, dim=-1)}

    def _get_rewards(self) -> torch.Tensor:
        cfg, failed = self.cfg, self.reset_terminated.float()
        return (
            cfg.rew_alive * (1.0 - failed)
            + cfg.rew_terminated * failed
            + cfg.rew_pole_pos * self.joint_pos[:, self._pole].square()
            + cfg.rew_cart_vel * self.joint_vel[:, self._cart].abs()
            + cfg.rew_pole_vel * self.joint_vel[:, self._pole].abs()
        )

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        time_out = self.episode_length_buf >= self.max_episode_length
        away = self.joint_pos[:, self._cart].abs() > self.cfg.max_cart_pos
        fallen = self.joint_pos[:, self._pole].abs() > math.pi / 2
        return away | fallen, time_out

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        super()._reset_idx(env_ids)
        ids = self.robot.env_indices(env_ids)
        joint_pos = self.robot.data.default_joint_pos[ids]
        limit = self.cfg.initial_pole_angle
        joint_pos[:, self._pole] += sample_uniform(-limit, limit, len(ids), self.device)
        self.robot.write_joint_state_to_sim(joint_pos, self.robot.data.default_joint_vel[ids], env_ids=ids)


@configclass
class CartpolePPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO that balances the pole within a minute on two CPU cores."""

    num_steps_per_env: int = 16
    max_iterations: int = 75
    save_interval: int = 25
    experiment_name: str = "cartpole_direct"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(32, 32), distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0)
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(32, 32))
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.005)
