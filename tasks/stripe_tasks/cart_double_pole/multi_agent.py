# SPDX-License-Identifier: Apache-2.0
"""Multi-agent cart with two poles, one on the other: ``Stripe-CartDoublePole-MARL-Direct-v0``.

One agent moves the cart, another one the upper joint, each with a reward for its own pole, as in Isaac Lab's
``Isaac-Cart-Double-Pendulum-Direct-v0``. Robot, episodes and shared numbers are those of
:mod:`stripe_tasks.cart_double_pole.direct`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectMARLEnv, DirectMARLEnvCfg
from stripe_newton.math import sample_uniform, wrap_to_pi
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import SimulationCfg
from stripe_tasks.robot_scene import spawn_scenery

from .direct import CartDoublePoleEnvCfg, CartDoublePolePPORunnerCfg

__all__ = ["CartDoublePoleMARLEnv", "CartDoublePoleMARLEnvCfg", "CartDoublePoleMARLPPORunnerCfg"]

TASK = CartDoublePoleEnvCfg()


@configclass
class CartDoublePoleMARLEnvCfg(DirectMARLEnvCfg):
    """Cart with two poles and two agents.

    The poles start near upright. An episode ends when the tip sinks, when the cart is too far out, or after 10 s.
    """

    decimation: int = TASK.decimation
    episode_length_s: float = TASK.episode_length_s
    possible_agents: list[str] = ["cart", "pendulum"]
    action_spaces: dict[str, Any] = {"cart": 1, "pendulum": 1}
    observation_spaces: dict[str, Any] = {"cart": 5, "pendulum": 5}
    state_space: Any = -1
    sim: SimulationCfg = TASK.sim
    scene: InteractiveSceneCfg = TASK.scene
    robot: ArticulationCfg = TASK.robot
    cart_action_scale: float = TASK.action_scale
    """Force on the cart for an action of one [N]."""
    pendulum_action_scale: float = 2.0
    """Torque between the poles for an action of one [N m]."""
    max_cart_pos: float = TASK.max_cart_pos
    """Distance from the middle of the rail at which an episode ends [m]."""
    initial_angle: float = TASK.initial_angle
    """Largest angle of each joint at the start [rad]."""
    min_height: float = TASK.min_height
    """Share of its upright height at which the tip ends the episode."""
    rew_alive: float = 1.0
    """Reward of each agent in a step in which the poles are up."""
    rew_terminated: float = -2.0
    """Reward of each agent for ending the episode before its full length."""
    rew_cart_pos: float = -0.02
    """Weight of the squared distance from the middle, for the cart."""
    rew_angle: float = -0.5
    """Weight of the squared angle from the vertical: of the lower pole for the cart, of the upper for the pendulum."""
    rew_vel: float = -0.002
    """Weight of the speed of the joint below that pole."""


class CartDoublePoleMARLEnv(DirectMARLEnv):
    """Balance two poles on a cart by two agents.

    The agent ``cart`` pushes the cart. It observes the cart's position and velocity, sine and cosine of the lower
    pole's angle from the vertical, and that pole's rate. The agent ``pendulum`` turns the joint between the poles. It
    observes sine and cosine of the upper pole's angle from the vertical, that pole's rate, and angle and rate of its
    joint. The state is both observations.
    """

    cfg: CartDoublePoleMARLEnvCfg

    def __init__(self, cfg: CartDoublePoleMARLEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        joints = ["railCartJoint", "cartPoleJoint", "polePoleJoint"]
        self._cart, self._lower, self._upper = self.robot.find_joints(joints, preserve_order=True)[0]

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        spawn_scenery()
        self.scene.clone_environments(copy_from_source=False)

    def _pre_physics_step(self, actions: dict[str, torch.Tensor]) -> None:
        scales = {"cart": self.cfg.cart_action_scale, "pendulum": self.cfg.pendulum_action_scale}
        self.efforts = {agent: scale * actions[agent].clamp(-1.0, 1.0) for agent, scale in scales.items()}

    def _apply_action(self) -> None:
        self.robot.set_joint_effort_target(self.efforts["cart"], joint_ids=[self._cart])
        self.robot.set_joint_effort_target(self.efforts["pendulum"], joint_ids=[self._upper])

    def _angles(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Angles of both poles from the vertical [rad], shape ``(num_envs,)`` each."""
        pos = self.robot.data.joint_pos
        return wrap_to_pi(pos[:, self._lower]), wrap_to_pi(pos[:, self._lower] + pos[:, self._upper])

    def _get_observations(self) -> dict[str, torch.Tensor]:
        pos, vel = self.robot.data.joint_pos, self.robot.data.joint_vel
        lower, upper = self._angles()
        rate = vel[:, self._lower]
        cart = (pos[:, self._cart], vel[:, self._cart], lower.sin(), lower.cos(), rate)
        joint = wrap_to_pi(pos[:, self._upper]), vel[:, self._upper]
        pendulum = (upper.sin(), upper.cos(), rate + vel[:, self._upper], *joint)
        return {"cart": torch.stack(cart, dim=-1), "pendulum": torch.stack(pendulum, dim=-1)}

    def _get_rewards(self) -> dict[str, torch.Tensor]:
        cfg, failed = self.cfg, self.terminated_dict["cart"].float()
        pos, vel = self.robot.data.joint_pos, self.robot.data.joint_vel
        lower, upper = self._angles()
        both = cfg.rew_alive * (1.0 - failed) + cfg.rew_terminated * failed
        cart = cfg.rew_cart_pos * pos[:, self._cart].square() + cfg.rew_vel * vel[:, self._lower].abs()
        return {
            "cart": both + cart + cfg.rew_angle * lower.square(),
            "pendulum": both + cfg.rew_angle * upper.square() + cfg.rew_vel * vel[:, self._upper].abs(),
        }

    def _get_dones(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        time_out = self.episode_length_buf >= self.max_episode_length
        away = self.robot.data.joint_pos[:, self._cart].abs() > self.cfg.max_cart_pos
        lower, upper = self._angles()
        failed = away | (lower.cos() + upper.cos() < 2.0 * self.cfg.min_height)
        # both agents share the robot, so their episodes end together
        return dict.fromkeys(self.agents, failed), dict.fromkeys(self.agents, time_out)

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        super()._reset_idx(env_ids)
        ids = self.robot.env_indices(env_ids)
        joint_pos = self.robot.data.default_joint_pos[ids]
        limit = self.cfg.initial_angle
        joint_pos[:, [self._lower, self._upper]] += sample_uniform(-limit, limit, (len(ids), 2), self.device)
        self.robot.write_joint_state_to_sim(joint_pos, self.robot.data.default_joint_vel[ids], env_ids=ids)


@configclass
class CartDoublePoleMARLPPORunnerCfg(CartDoublePolePPORunnerCfg):
    """PPO for both agents as one, see :func:`stripe_newton.envs.multi_agent_to_single_agent`."""

    experiment_name: str = "cart_double_pole_marl_direct"
