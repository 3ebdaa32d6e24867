# SPDX-License-Identifier: Apache-2.0
"""Direct velocity task of the quadruped in Warp: ``Stripe-Velocity-Flat-Quadruped-Direct-Warp-v0``."""

from __future__ import annotations

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ActionData, ArticulationData, EpisodeData
from stripe_kernels.sensors.contact import ContactSensorData
from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass

from .direct_warp import VelocityTask, VelocityWarpEnv, VelocityWarpEnvCfg, earn
from .quadruped import ROBOT_CFG, QuadrupedFlatPPORunnerCfg

__all__ = ["QuadrupedFlatWarpEnv", "QuadrupedFlatWarpEnvCfg", "QuadrupedFlatWarpPPORunnerCfg"]


@configclass
class QuadrupedFlatWarpEnvCfg(VelocityWarpEnvCfg):
    """Quadruped on a plane: 48 observations, 12 joint positions."""

    observation_space: int = 48
    state_space: int = 48
    action_space: int = 12
    robot: ArticulationCfg = ROBOT_CFG
    feet: str = ".*_foot"
    fallen: str = "base"
    legs: str = ".*_(thigh|calf)"
    """Bodies that should touch nothing."""
    weights: dict[str, float] = {
        "track_lin_vel_xy_exp": 1.5,
        "track_ang_vel_z_exp": 0.75,
        "lin_vel_z_l2": -2.0,
        "ang_vel_xy_l2": -0.05,
        "joint_torques_l2": -2.0e-4,
        "joint_acc_l2": -2.5e-7,
        "action_rate_l2": -0.01,
        "flat_orientation_l2": -2.5,
        "joint_pos_limits": -1.0,
        "feet_air_time": 0.25,
        "undesired_contacts": -1.0,
    }


@wp.kernel(enable_backward=False)
def quadruped_rewards(
    robot: ArticulationData,
    actions: ActionData,
    episode: EpisodeData,
    sensor: ContactSensorData,
    task: VelocityTask,
    sums: wp.array2d[float],
    legs: wp.array[int],
    reward: wp.array[float],
) -> None:
    """Reward following the command, less unsteady motion and contacts of the legs."""
    env = wp.tid()
    reward[env] = 0.0
    air_time = mdp.feet_air_time(env, sensor, task.command, task.feet, 0.5, task.step_dt, 0.1)
    earn(env, 0, mdp.track_lin_vel_xy_exp(env, robot, task.command, 0.5), task, sums, reward)
    earn(env, 1, mdp.track_ang_vel_z_exp(env, robot, task.command, 0.5), task, sums, reward)
    earn(env, 2, mdp.lin_vel_z_l2(env, robot), task, sums, reward)
    earn(env, 3, mdp.ang_vel_xy_l2(env, robot), task, sums, reward)
    earn(env, 4, mdp.joint_torques_l2(env, robot, task.joint_ids), task, sums, reward)
    earn(env, 5, mdp.joint_acc_l2(env, robot, task.joint_ids), task, sums, reward)
    earn(env, 6, mdp.action_rate_l2(env, actions), task, sums, reward)
    earn(env, 7, mdp.flat_orientation_l2(env, robot), task, sums, reward)
    earn(env, 8, mdp.joint_pos_limits(env, robot, task.joint_ids), task, sums, reward)
    earn(env, 9, air_time, task, sums, reward)
    earn(env, 10, mdp.undesired_contacts(env, sensor, legs, 1.0), task, sums, reward)


class QuadrupedFlatWarpEnv(VelocityWarpEnv):
    """The quadruped walks; see :class:`VelocityWarpEnv`."""

    cfg: QuadrupedFlatWarpEnvCfg
    reward_kernel = quadruped_rewards
    reward_terms = tuple(QuadrupedFlatWarpEnvCfg().weights)

    def _reward_groups(self) -> list[wp.array]:
        legs = self.contact_forces.find_bodies(self.cfg.legs)[0]
        return [wp.array(legs, dtype=int, device=self.device)]


@configclass
class QuadrupedFlatWarpPPORunnerCfg(QuadrupedFlatPPORunnerCfg):
    """PPO for the quadruped on a plane."""

    experiment_name: str = "velocity_flat_quadruped_direct_warp"
