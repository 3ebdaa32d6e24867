# SPDX-License-Identifier: Apache-2.0
"""Direct cart-pole in Warp: ``Stripe-Cartpole-Direct-Warp-v0``.

Observations, rewards, dones and config are those of :mod:`stripe_tasks.cartpole.direct`. Each hook is one kernel.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ArticulationData, EpisodeData
from stripe_newton.assets import Articulation
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv
from stripe_tasks.robot_scene import spawn_scenery

from .direct import CartpoleEnvCfg, CartpolePPORunnerCfg

__all__ = ["CartpoleWarpEnv", "CartpoleWarpPPORunnerCfg"]


@wp.kernel(enable_backward=False)
def set_force(actions: wp.array2d[float], robot: ArticulationData, cart: int, scale: float) -> None:
    """Set the force on the cart."""
    env = wp.tid()
    robot.joint_effort_target[env, cart] = scale * actions[env, 0]


@wp.kernel(enable_backward=False)
def compute_dones(
    robot: ArticulationData,
    episode: EpisodeData,
    cart: int,
    pole: int,
    max_cart_pos: float,
    terminated: wp.array[wp.bool],
    truncated: wp.array[wp.bool],
) -> None:
    """End an episode when the cart is too far out, when the pole has fallen, or after its full length."""
    env = wp.tid()
    away = wp.abs(robot.joint_pos[env, cart]) > max_cart_pos
    fallen = wp.abs(robot.joint_pos[env, pole]) > 0.5 * wp.pi
    terminated[env] = away or fallen
    truncated[env] = mdp.time_out(env, episode)


@wp.kernel(enable_backward=False)
def compute_rewards(
    robot: ArticulationData,
    episode: EpisodeData,
    cart: int,
    pole: int,
    rew_alive: float,
    rew_terminated: float,
    rew_pole_pos: float,
    rew_cart_vel: float,
    rew_pole_vel: float,
    reward: wp.array[float],
) -> None:
    """Reward being up, less costs of the pole's angle and of both speeds."""
    env = wp.tid()
    angle = robot.joint_pos[env, pole]
    total = rew_alive * mdp.is_alive(env, episode) + rew_terminated * mdp.is_terminated(env, episode)
    total += rew_pole_pos * angle * angle
    total += rew_cart_vel * wp.abs(robot.joint_vel[env, cart])
    total += rew_pole_vel * wp.abs(robot.joint_vel[env, pole])
    reward[env] = total


@wp.kernel(enable_backward=False)
def reset_envs(
    mask: wp.array[wp.bool], robot: ArticulationData, rng: wp.array[wp.uint32], pole: int, limit: float
) -> None:
    """Put the pole at a random angle and the cart at its default position."""
    env = wp.tid()
    if mask[env]:
        mdp.reset_joints_to_default(env, robot)
        robot.joint_pos[env, pole] += mdp.random.uniform_range(env, rng, wp.vec2(-limit, limit))


@wp.kernel(enable_backward=False)
def compute_observations(robot: ArticulationData, cart: int, pole: int, out: wp.array2d[float]) -> None:
    """Write angle and rate of the pole, position and rate of the cart."""
    env = wp.tid()
    out[env, 0] = robot.joint_pos[env, pole]
    out[env, 1] = robot.joint_vel[env, pole]
    out[env, 2] = robot.joint_pos[env, cart]
    out[env, 3] = robot.joint_vel[env, cart]


class CartpoleWarpEnv(DirectRLEnv):
    """Balance a pole on a cart.

    Observations: pole angle [rad], its rate, cart position [m], its rate. Action: force on the cart.
    """

    cfg: CartpoleEnvCfg

    def __init__(self, cfg: CartpoleEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        self._cart = self.robot.find_joints(cfg.cart_joint)[0][0]
        self._pole = self.robot.find_joints(cfg.pole_joint)[0][0]

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        spawn_scenery()
        self.scene.clone_environments(copy_from_source=False)

    def _launch(self, kernel: wp.Kernel, *arguments: Any) -> None:
        wp.launch(kernel, dim=self.num_envs, inputs=arguments, device=self.device)

    def _launch_pre_physics_step(self, actions: wp.array2d[float]) -> None:
        self._launch(set_force, actions, self.robot.data.struct, self._cart, self.cfg.action_scale)

    def _launch_dones(self) -> None:
        w, joints = self.warp, (self._cart, self._pole)
        ends = self.cfg.max_cart_pos, w.terminated, w.truncated
        self._launch(compute_dones, self.robot.data.struct, w.episode, *joints, *ends)

    def _launch_rewards(self) -> None:
        cfg, w = self.cfg, self.warp
        weights = cfg.rew_alive, cfg.rew_terminated, cfg.rew_pole_pos, cfg.rew_cart_vel, cfg.rew_pole_vel
        self._launch(compute_rewards, self.robot.data.struct, w.episode, self._cart, self._pole, *weights, w.reward)

    def _launch_reset(self, env_mask: wp.array[wp.bool]) -> None:
        start = self._pole, self.cfg.initial_pole_angle
        self._launch(reset_envs, env_mask, self.robot.data.struct, self.warp.rng, *start)

    def _launch_observations(self) -> None:
        out = self.warp.observations["policy"]
        self._launch(compute_observations, self.robot.data.struct, self._cart, self._pole, out)


@configclass
class CartpoleWarpPPORunnerCfg(CartpolePPORunnerCfg):
    """PPO that balances the pole."""

    experiment_name: str = "cartpole_direct_warp"
