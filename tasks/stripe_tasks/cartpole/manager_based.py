# SPDX-License-Identifier: Apache-2.0
"""Manager-based cart-pole: ``Stripe-Cartpole-v0``.

Observations, rewards, dones and their numbers are those of :mod:`stripe_tasks.cartpole.direct`.
"""

from __future__ import annotations

import math

from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.sim import SimulationCfg
from stripe_tasks.robot_scene import RobotSceneCfg

from .direct import CartpoleEnvCfg, CartpolePPORunnerCfg

__all__ = ["CartpoleManagerEnvCfg", "CartpoleManagerPPORunnerCfg"]

TASK = CartpoleEnvCfg()
CART = {"asset_cfg": SceneEntityCfg("robot", joint_names=[TASK.cart_joint])}
POLE = {"asset_cfg": SceneEntityCfg("robot", joint_names=[TASK.pole_joint])}


@configclass
class ObservationsCfg:
    """Observations of the policy."""

    @configclass
    class PolicyCfg(ObservationGroupCfg):
        """Angle and rate of the pole, position and rate of the cart."""

        pole_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos, params=POLE)
        pole_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel, params=POLE)
        cart_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos, params=CART)
        cart_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel, params=CART)

    policy: PolicyCfg = PolicyCfg()


@configclass
class ActionsCfg:
    """Action: a force on the cart."""

    joint_effort: mdp.JointEffortActionCfg = mdp.JointEffortActionCfg(
        asset_name="robot", joint_names=[TASK.cart_joint], scale=TASK.action_scale
    )


@configclass
class RewardsCfg:
    """Rewards for being up, less costs of the pole's angle and of both speeds."""

    alive: RewardTermCfg = RewardTermCfg(func=mdp.is_alive, weight=TASK.rew_alive)
    terminating: RewardTermCfg = RewardTermCfg(func=mdp.is_terminated, weight=TASK.rew_terminated)
    pole_pos: RewardTermCfg = RewardTermCfg(
        func=mdp.joint_pos_target_l2, weight=TASK.rew_pole_pos, params={**POLE, "target": 0.0}
    )
    cart_vel: RewardTermCfg = RewardTermCfg(func=mdp.joint_vel_l1, weight=TASK.rew_cart_vel, params=CART)
    pole_vel: RewardTermCfg = RewardTermCfg(func=mdp.joint_vel_l1, weight=TASK.rew_pole_vel, params=POLE)


@configclass
class TerminationsCfg:
    """An episode ends when the cart is too far out, when the pole has fallen, or after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)
    cart_out_of_bounds: TerminationTermCfg = TerminationTermCfg(
        func=mdp.joint_pos_out_of_manual_limit, params={**CART, "bounds": (-TASK.max_cart_pos, TASK.max_cart_pos)}
    )
    pole_fallen: TerminationTermCfg = TerminationTermCfg(
        func=mdp.joint_pos_out_of_manual_limit, params={**POLE, "bounds": (-0.5 * math.pi, 0.5 * math.pi)}
    )


@configclass
class EventsCfg:
    """The pole starts at a random angle, all else at rest."""

    reset_joints: EventTermCfg = EventTermCfg(func=mdp.reset_joints_to_default, mode="reset")
    reset_pole: EventTermCfg = EventTermCfg(
        func=mdp.reset_joints_by_offset,
        mode="reset",
        params={
            **POLE,
            "position_range": (-TASK.initial_pole_angle, TASK.initial_pole_angle),
            "velocity_range": (0.0, 0.0),
        },
    )


@configclass
class CartpoleManagerEnvCfg(ManagerBasedRLEnvCfg):
    """Manager-based cart-pole, with the numbers of the direct one."""

    decimation: int = TASK.decimation
    episode_length_s: float = TASK.episode_length_s
    sim: SimulationCfg = TASK.sim
    scene: RobotSceneCfg = RobotSceneCfg(
        num_envs=TASK.scene.num_envs, env_spacing=TASK.scene.env_spacing, robot=TASK.robot
    )
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()
    scale_rewards_by_dt: bool = False  # as the direct form, whose rewards are those of a step


@configclass
class CartpoleManagerPPORunnerCfg(CartpolePPORunnerCfg):
    """PPO that balances the pole."""

    experiment_name: str = "cartpole"
