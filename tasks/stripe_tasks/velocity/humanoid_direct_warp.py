# SPDX-License-Identifier: Apache-2.0
"""Direct velocity task of the humanoid in Warp: ``Stripe-Velocity-Flat-Humanoid-Direct-Warp-v0``."""

from __future__ import annotations

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ActionData, ArticulationData, EpisodeData
from stripe_kernels.sensors.contact import ContactSensorData
from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass

from .direct_warp import VelocityTask, VelocityWarpEnv, VelocityWarpEnvCfg, earn
from .humanoid import ROBOT_CFG, HumanoidFlatPPORunnerCfg

__all__ = ["HumanoidFlatWarpEnv", "HumanoidFlatWarpEnvCfg", "HumanoidFlatWarpPPORunnerCfg"]


@configclass
class HumanoidFlatWarpEnvCfg(VelocityWarpEnvCfg):
    """Humanoid on a plane: 75 observations, 21 joint positions."""

    observation_space: int = 75
    state_space: int = 75
    action_space: int = 21
    robot: ArticulationCfg = ROBOT_CFG
    feet: str = ".*_foot"
    fallen: str = "torso|pelvis|head|.*_thigh|.*_arm"
    hips: str = ".*_thigh:[02]"
    """Joints of the hips that should stay near their default."""
    arms: str = ".*_upper_arm:.|.*_elbow"
    """Joints of the arms that should stay near their default."""
    waist: str = "lower_waist:.|abdomen_x"
    """Joints of the waist that should stay near their default."""
    action_scale: float = 0.5
    lin_vel_x: tuple[float, float] = (-0.5, 1.0)
    lin_vel_y: tuple[float, float] = (-0.3, 0.3)
    weights: dict[str, float] = {
        "track_lin_vel_xy_exp": 1.5,
        "track_ang_vel_z_exp": 1.0,
        "lin_vel_z_l2": -0.2,
        "ang_vel_xy_l2": -0.05,
        "joint_torques_l2": -2.0e-6,
        "joint_acc_l2": -1.25e-7,
        "action_rate_l2": -0.005,
        "flat_orientation_l2": -1.0,
        "joint_pos_limits": -1.0,
        "feet_air_time": 1.0,
        "feet_slide": -0.25,
        "is_terminated": -200.0,
        "joint_deviation_hip": -0.2,
        "joint_deviation_arms": -0.2,
        "joint_deviation_waist": -0.2,
    }


@wp.kernel(enable_backward=False)
def humanoid_rewards(
    robot: ArticulationData,
    actions: ActionData,
    episode: EpisodeData,
    sensor: ContactSensorData,
    task: VelocityTask,
    sums: wp.array2d[float],
    hips: wp.array[int],
    arms: wp.array[int],
    waist: wp.array[int],
    reward: wp.array[float],
) -> None:
    """Reward walking as commanded, upright, one foot after the other, with the arms down."""
    env = wp.tid()
    reward[env] = 0.0
    air_time = mdp.feet_air_time_positive_biped(env, sensor, task.command, task.feet, 0.5, 0.1)
    slide = mdp.feet_slide(env, robot, sensor, task.feet, task.foot_bodies, 1.0)
    earn(env, 0, mdp.track_lin_vel_xy_yaw_frame_exp(env, robot, task.command, 0.5), task, sums, reward)
    earn(env, 1, mdp.track_ang_vel_z_world_exp(env, robot, task.command, 0.5), task, sums, reward)
    earn(env, 2, mdp.lin_vel_z_l2(env, robot), task, sums, reward)
    earn(env, 3, mdp.ang_vel_xy_l2(env, robot), task, sums, reward)
    earn(env, 4, mdp.joint_torques_l2(env, robot, task.joint_ids), task, sums, reward)
    earn(env, 5, mdp.joint_acc_l2(env, robot, task.joint_ids), task, sums, reward)
    earn(env, 6, mdp.action_rate_l2(env, actions), task, sums, reward)
    earn(env, 7, mdp.flat_orientation_l2(env, robot), task, sums, reward)
    earn(env, 8, mdp.joint_pos_limits(env, robot, task.joint_ids), task, sums, reward)
    earn(env, 9, air_time, task, sums, reward)
    earn(env, 10, slide, task, sums, reward)
    earn(env, 11, mdp.is_terminated(env, episode), task, sums, reward)
    earn(env, 12, mdp.joint_deviation_l1(env, robot, hips), task, sums, reward)
    earn(env, 13, mdp.joint_deviation_l1(env, robot, arms), task, sums, reward)
    earn(env, 14, mdp.joint_deviation_l1(env, robot, waist), task, sums, reward)


class HumanoidFlatWarpEnv(VelocityWarpEnv):
    """The humanoid walks; see :class:`VelocityWarpEnv`."""

    cfg: HumanoidFlatWarpEnvCfg
    reward_kernel = humanoid_rewards
    reward_terms = tuple(HumanoidFlatWarpEnvCfg().weights)

    def _reward_groups(self) -> list[wp.array]:
        groups = self.cfg.hips, self.cfg.arms, self.cfg.waist
        return [wp.array(self.robot.find_joints(g)[0], dtype=int, device=self.device) for g in groups]


@configclass
class HumanoidFlatWarpPPORunnerCfg(HumanoidFlatPPORunnerCfg):
    """PPO for the humanoid on a plane."""

    experiment_name: str = "velocity_flat_humanoid_direct_warp"
