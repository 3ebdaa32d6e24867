# SPDX-License-Identifier: Apache-2.0
"""Direct cart with two poles, one on the other: ``Stripe-CartDoublePole-Direct-v0``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch

from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.math import sample_uniform, wrap_to_pi
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_tasks.robot_scene import spawn_scenery
from stripe_tasks.robots import CART_DOUBLE_POLE_CFG

__all__ = ["CartDoublePoleEnv", "CartDoublePoleEnvCfg", "CartDoublePolePPORunnerCfg"]


@configclass
class CartDoublePoleEnvCfg(DirectRLEnvCfg):
    """Direct cart with two poles.

    The poles start near upright. An episode ends when the tip sinks, when the cart is too far out, or after 10 s.
    """

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ("action_space", "observation_space")

    decimation: int = 2
    episode_length_s: float = 10.0
    action_space: int = 1
    observation_space: int = 8
    sim: SimulationCfg = SimulationCfg(
        dt=1.0 / 120.0,
        render_interval=2,
        solver=MuJoCoSolverCfg(disable_contacts=True),  # cart and poles can touch nothing
    )
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=512, env_spacing=4.0)
    robot: ArticulationCfg = CART_DOUBLE_POLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    action_scale: float = 50.0
    """Force for an action of one [N]."""
    max_cart_pos: float = 3.0
    """Distance from the middle of the rail at which an episode ends [m]."""
    initial_angle: float = 0.1
    """Largest angle of each pole at the start [rad]."""
    min_height: float = 0.5
    """Share of its upright height at which the tip ends the episode."""
    rew_alive: float = 1.0
    """Reward of a step in which the poles are up."""
    rew_terminated: float = -2.0
    """Reward for ending the episode before its full length."""
    rew_angle: float = -0.5
    """Weight of the squared angles of both poles from the vertical."""
    rew_cart_pos: float = -0.02
    """Weight of the squared distance from the middle."""
    rew_vel: float = -0.002
    """Weight of the poles' angular speeds."""


class CartDoublePoleEnv(DirectRLEnv):
    """Balance two poles on a cart.

    Observations: cart position and velocity; sine and cosine of both poles' angles from the vertical; their rates.
    Action: force on the cart. The dynamics are those of gymnasium's InvertedDoublePendulum, with a longer rail.
    """

    cfg: CartDoublePoleEnvCfg

    def __init__(self, cfg: CartDoublePoleEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        joints = ["railCartJoint", "cartPoleJoint", "polePoleJoint"]
        self._cart, self._pole1, self._pole2 = self.robot.find_joints(joints, preserve_order=True)[0]

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        spawn_scenery()
        self.scene.clone_environments(copy_from_source=False)

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        self.actions = self.cfg.action_scale * actions.clamp(-1.0, 1.0)

    def _apply_action(self) -> None:
        self.robot.set_joint_effort_target(self.actions, joint_ids=[self._cart])

    def _angles(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Angles of both poles from the vertical [rad], shape ``(num_envs,)`` each."""
        pos = self.robot.data.joint_pos
        return wrap_to_pi(pos[:, self._pole1]), wrap_to_pi(pos[:, self._pole1] + pos[:, self._pole2])

    def _get_observations(self) -> dict[str, torch.Tensor]:
        pos, vel = self.robot.data.joint_pos, self.robot.data.joint_vel
        first, second = self._angles()
        columns = (pos[:, self._cart], vel[:, self._cart], first.sin(), first.cos(), second.sin(), second.cos(),
                   vel[:, self._pole1], vel[:, self._pole1] + vel[:, self._pole2])  # fmt: skip
        return {"policy": torch.stack(columns, dim=-1)}

    def _get_rewards(self) -> torch.Tensor:
        cfg, failed = self.cfg, self.reset_terminated.float()
        first, second = self._angles()
        vel = self.robot.data.joint_vel
        return (
            cfg.rew_alive * (1.0 - failed)
            + cfg.rew_terminated * failed
            + cfg.rew_angle * (first.square() + second.square())
            + cfg.rew_cart_pos * self.robot.data.joint_pos[:, self._cart].square()
            + cfg.rew_vel * (vel[:, self._pole1].abs() + vel[:, self._pole2].abs())
        )

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        time_out = self.episode_length_buf >= self.max_episode_length
        away = self.robot.data.joint_pos[:, self._cart].abs() > self.cfg.max_cart_pos
        first, second = self._angles()
        # height of the tip over the cart, by the length of both poles: half the sum of the cosines
        return away | (first.cos() + second.cos() < 2.0 * self.cfg.min_height), time_out

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        super()._reset_idx(env_ids)
        ids = self.robot.env_indices(env_ids)
        joint_pos = self.robot.data.default_joint_pos[ids]
        limit = self.cfg.initial_angle
        joint_pos[:, [self._pole1, self._pole2]] += sample_uniform(-limit, limit, (len(ids), 2), self.device)
        self.robot.write_joint_state_to_sim(joint_pos, self.robot.data.default_joint_vel[ids], env_ids=ids)


@configclass
class CartDoublePolePPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO that balances both poles."""

    num_steps_per_env: int = 24
    max_iterations: int = 200
    save_interval: int = 50
    experiment_name: str = "cart_double_pole_direct"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(64, 64),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(64, 64), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.0)
