# SPDX-License-Identifier: Apache-2.0
"""Direct locomotion in Warp: ``Stripe-Ant-Direct-Warp-v0`` and ``Stripe-Humanoid-Direct-Warp-v0``.

Observations, rewards, dones and configs are those of :mod:`stripe_tasks.locomotion.direct`. Each hook is one kernel.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ActionData, ArticulationData, EpisodeData
from stripe_kernels.episode import log_add
from stripe_newton.assets import Articulation
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv
from stripe_tasks.robot_scene import spawn_scenery

from . import terms
from .direct import AntEnvCfg, AntPPORunnerCfg, HumanoidEnvCfg, HumanoidPPORunnerCfg, LocomotionEnvCfg

__all__ = ["AntWarpEnv", "AntWarpPPORunnerCfg", "HumanoidWarpEnv", "HumanoidWarpPPORunnerCfg", "LocomotionWarpEnv"]


@wp.struct
class Numbers:
    """Numbers of a :class:`LocomotionEnvCfg` for kernels, under the names that they have there."""

    target_distance: float
    heading_weight: float
    up_weight: float
    alive_reward: float
    death_cost: float
    actions_cost: float
    power_cost: float
    at_limit_cost: float
    joint_vel_scale: float
    ang_vel_scale: float
    termination_height: float


def numbers_of(cfg: LocomotionEnvCfg) -> Any:
    """Struct of the numbers of a config."""
    numbers: Any = Numbers()
    for name in numbers._cls.vars:
        setattr(numbers, name, getattr(cfg, name))
    return numbers


@wp.kernel(enable_backward=False)
def set_efforts(actions: wp.array2d[float], efforts: wp.array[float], robot: ArticulationData) -> None:
    """Set torques for the actions, which are clamped to [-1, 1]; one thread for each joint."""
    env, joint = wp.tid()
    robot.joint_effort_target[env, joint] = efforts[joint] * wp.clamp(actions[env, joint], -1.0, 1.0)


@wp.kernel(enable_backward=False)
def compute_dones(
    robot: ArticulationData,
    episode: EpisodeData,
    numbers: Numbers,
    terminated: wp.array[wp.bool],
    truncated: wp.array[wp.bool],
) -> None:
    """End an episode when the torso is too low, or after its full length."""
    env = wp.tid()
    storey = robot.env_origin[env][2]  # 0 on a plane
    terminated[env] = mdp.root_height_below_minimum(env, robot, storey + numbers.termination_height)
    truncated[env] = mdp.time_out(env, episode)


@wp.kernel(enable_backward=False)
def compute_rewards(
    robot: ArticulationData,
    actions: ActionData,
    episode: EpisodeData,
    numbers: Numbers,
    joint_ids: wp.array[int],
    gear_ratio: wp.array[float],
    last_pos: wp.array[wp.vec2],
    log_sums: wp.array[float],
    log_counts: wp.array[int],
    log_progress: int,
    reward: wp.array[float],
) -> None:
    """Reward progress, facing the target and staying up, less effort, power and joints near their limits."""
    env = wp.tid()
    n = numbers
    progress = terms.progress_reward(env, robot, episode, last_pos, n.target_distance)
    facing = terms.move_to_target_bonus(env, robot, episode, terms.FACING, n.target_distance)
    upright = terms.upright_posture_bonus(env, robot, episode, terms.UPRIGHT)
    effort = terms.action_l2(env, actions, episode)
    power = terms.power_consumption(env, robot, actions, episode, joint_ids, gear_ratio)
    at_limit = terms.joint_pos_limits_penalty(env, robot, episode, joint_ids, terms.NEAR_LIMIT)
    total = progress + n.alive_reward * mdp.is_alive(env, episode) + n.up_weight * upright + n.heading_weight * facing
    total -= n.actions_cost * effort + n.power_cost * n.joint_vel_scale * power + n.at_limit_cost * at_limit
    reward[env] = total + n.death_cost * mdp.is_terminated(env, episode)
    log_add(log_sums, log_counts, log_progress, progress)


@wp.kernel(enable_backward=False)
def reset_envs(
    mask: wp.array[wp.bool], robot: ArticulationData, actions: wp.array2d[float], last_pos: wp.array[wp.vec2]
) -> None:
    """Put the robot where an episode starts."""
    env = wp.tid()
    if mask[env]:
        mdp.reset_root_to_default(env, robot)
        mdp.reset_joints_to_default(env, robot)
        terms.remember_position(env, robot, last_pos)  # after the root: progress counts from its new place
        for i in range(actions.shape[1]):
            actions[env, i] = 0.0


@wp.kernel(enable_backward=False)
def compute_observations(
    robot: ArticulationData, actions: ActionData, numbers: Numbers, joint_ids: wp.array[int], out: wp.array2d[float]
) -> None:
    """Write the observations in the order that :class:`LocomotionWarpEnv` gives."""
    env = wp.tid()
    joints = joint_ids.shape[0]
    positions = 12 + joints
    velocities = positions + joints
    mdp.base_pos_z(env, robot, out[env, 0:1])
    mdp.base_lin_vel(env, robot, out[env, 1:4])
    mdp.base_ang_vel(env, robot, out[env, 4:7])
    terms.base_yaw_roll(env, robot, out[env, 7:9])
    terms.base_angle_to_target(env, robot, numbers.target_distance, out[env, 9:10])
    terms.base_up_proj(env, robot, out[env, 10:11])
    terms.base_heading_proj(env, robot, numbers.target_distance, out[env, 11:12])
    mdp.joint_pos_limit_normalized(env, robot, joint_ids, out[env, 12:positions])
    mdp.joint_vel(env, robot, joint_ids, out[env, positions:velocities])
    terms.last_action(env, actions, out[env, velocities : velocities + joints])
    for i in range(4, 7):
        out[env, i] *= numbers.ang_vel_scale
    for i in range(positions, velocities):
        out[env, i] *= numbers.joint_vel_scale


class LocomotionWarpEnv(DirectRLEnv):
    """Run to a far target.

    Observations, in this order: torso height; linear and angular velocity in the torso's frame; yaw, roll; angle to the
    target; projections of up and of heading; joint positions scaled to their limits; joint velocities; actions.
    """

    cfg: LocomotionEnvCfg

    def __init__(self, cfg: LocomotionEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        joints, device = self.robot.num_joints, self.device
        # efforts by joint; joints of no expression get none
        gears = [0.0] * joints
        for expression, gear in cfg.joint_gears.items():
            for joint in self.robot.find_joints(expression)[0]:
                gears[joint] = gear
        self._efforts = wp.array([cfg.action_scale * gear for gear in gears], dtype=float, device=device)
        self._gear_ratio = wp.array([gear / max(gears) for gear in gears], dtype=float, device=device)
        self._joint_ids = wp.array(list(range(joints)), dtype=int, device=device)
        # an array of the context is saved with a checkpoint
        self._last_pos = self.context.array("last_root_pos", wp.vec2)
        self._actions = ActionData()
        self._actions.action = self.warp.actions
        self._numbers = numbers_of(cfg)
        self._log_progress = self.warp.log.add("Episode_Reward/progress", "mean")

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        spawn_scenery(self.cfg.ground)
        self.scene.clone_environments(copy_from_source=False)

    def _launch(self, kernel: wp.Kernel, *arguments: Any, columns: tuple[int, ...] = ()) -> None:
        wp.launch(kernel, dim=(self.num_envs, *columns), inputs=arguments, device=self.device)

    def _launch_pre_physics_step(self, actions: wp.array2d[float]) -> None:
        self._launch(set_efforts, actions, self._efforts, self.robot.data.struct, columns=actions.shape[1:])

    def _launch_dones(self) -> None:
        w, robot = self.warp, self.robot.data.struct
        self._launch(compute_dones, robot, w.episode, self._numbers, w.terminated, w.truncated)

    def _launch_rewards(self) -> None:
        w, robot = self.warp, self.robot.data.struct
        state = robot, self._actions, w.episode, self._numbers, self._joint_ids, self._gear_ratio, self._last_pos
        self._launch(compute_rewards, *state, w.log.sums, w.log.counts, self._log_progress, w.reward)

    def _launch_reset(self, env_mask: wp.array[wp.bool]) -> None:
        self._launch(reset_envs, env_mask, self.robot.data.struct, self.warp.actions, self._last_pos)

    def _launch_observations(self) -> None:
        state = self.robot.data.struct, self._actions, self._numbers, self._joint_ids
        self._launch(compute_observations, *state, self.warp.observations["policy"])


class AntWarpEnv(LocomotionWarpEnv):
    """The ant runs; see :class:`LocomotionWarpEnv`."""

    cfg: AntEnvCfg


class HumanoidWarpEnv(LocomotionWarpEnv):
    """The humanoid runs; see :class:`LocomotionWarpEnv`."""

    cfg: HumanoidEnvCfg


@configclass
class AntWarpPPORunnerCfg(AntPPORunnerCfg):
    """PPO that makes the ant run."""

    experiment_name: str = "ant_direct_warp"


@configclass
class HumanoidWarpPPORunnerCfg(HumanoidPPORunnerCfg):
    """PPO that makes the humanoid run."""

    experiment_name: str = "humanoid_direct_warp"
