# SPDX-License-Identifier: Apache-2.0
"""Direct tasks in which an ant or a humanoid runs forward: ``Stripe-Ant-Direct-v0`` and ``Stripe-Humanoid-Direct-v0``.

Observations and rewards are those that Isaac Gym's, gymnasium's and Isaac Lab's ant and humanoid have in common: the
torso's motion in its own frame, its direction to a far target, the joints, the last actions; rewards for progress to
the target, facing it and staying up, costs for effort, power and joints at their limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch

from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.math import (
    euler_xyz_from_quat,
    normalize,
    quat_apply,
    quat_apply_inverse,
    scale_transform,
    wrap_to_pi,
)
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import GroundPlaneCfg, MuJoCoSolverCfg, RigidBodyMaterialCfg, SimulationCfg
from stripe_tasks.robot_scene import spawn_scenery
from stripe_tasks.robots import ANT_CFG, HUMANOID_CFG

__all__ = [
    "AntEnv",
    "AntEnvCfg",
    "AntPPORunnerCfg",
    "HumanoidEnv",
    "HumanoidEnvCfg",
    "HumanoidPPORunnerCfg",
    "LocomotionEnv",
    "LocomotionEnvCfg",
    "LocomotionPPORunnerCfg",
]


@configclass
class LocomotionEnvCfg(DirectRLEnvCfg):
    """Direct locomotion: episodes of 15 s with steps at 60 Hz and physics at 120 Hz."""

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ("action_space", "observation_space")

    decimation: int = 2
    episode_length_s: float = 15.0
    sim: SimulationCfg = SimulationCfg(
        dt=1.0 / 120.0, render_interval=2, solver=MuJoCoSolverCfg(iterations=20, ls_iterations=10)
    )
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=4096, env_spacing=4.0)
    ground: GroundPlaneCfg = GroundPlaneCfg(
        physics_material=RigidBodyMaterialCfg(static_friction=1.0, dynamic_friction=1.0)
    )
    robot: ArticulationCfg = MISSING
    joint_gears: dict[str, float] = MISSING
    """Effort for an action of one, by joint-name expression [N m]."""
    action_scale: float = 1.0
    """Factor on all gears."""
    target_distance: float = 1000.0
    """Distance of the target from the origin of the environment along x [m]: so far that the robot never gets there."""
    heading_weight: float = 0.5
    """Weight of facing the target."""
    up_weight: float = 0.1
    """Reward of a step in which the torso is upright."""
    alive_reward: float = 0.5
    """Reward of a step without a fall."""
    death_cost: float = -2.0
    """Reward of the step with the fall, in place of all other terms."""
    actions_cost: float = 0.005
    """Cost of the squared actions."""
    power_cost: float = 0.05
    """Cost of action times joint velocity."""
    at_limit_cost: float = 1.0
    """Cost for each joint near a limit."""
    joint_vel_scale: float = 0.2
    """Factor on the observed joint velocities."""
    ang_vel_scale: float = 1.0
    """Factor on the observed angular velocity."""
    termination_height: float = MISSING
    """Height of the torso below which an episode ends [m]."""


class LocomotionEnv(DirectRLEnv):
    """Run to a far target.

    Observations, in this order: torso height; linear and angular velocity in the torso's frame; yaw, roll; angle to the
    target; projections of up and of heading; joint positions scaled to their limits; joint velocities; actions.
    """

    cfg: LocomotionEnvCfg

    def __init__(self, cfg: LocomotionEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        gears = torch.zeros(self.robot.num_joints, device=self.device)
        for expression, gear in cfg.joint_gears.items():
            gears[self.robot.find_joints(expression)[0]] = gear
        self._efforts = cfg.action_scale * gears
        self._gear_ratio = gears / gears.max()  # strong joints pay for their power in full
        self._target = self.scene.env_origins.clone()
        self._target[:, 0] += cfg.target_distance
        self._up = torch.tensor([0.0, 0.0, 1.0], device=self.device).expand(self.num_envs, 3)
        self._forward = self.robot.data.FORWARD_VEC_B
        self._last_pos = torch.zeros(self.num_envs, 2, device=self.device)

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        spawn_scenery(self.cfg.ground)
        self.scene.clone_environments(copy_from_source=False)

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        self.actions = actions.clamp(-1.0, 1.0)

    def _apply_action(self) -> None:
        self.robot.set_joint_effort_target(self._efforts * self.actions)

    def _compute_torso_relations(self) -> None:
        """Compute the torso's pose relative to the target; called after the physics and after resets."""
        data = self.robot.data
        to_target = self._target - data.root_pos_w
        to_target[:, 2] = 0.0  # heading is a matter of the ground plane
        self._up_proj = quat_apply(data.root_quat_w, self._up)[:, 2]
        self._heading_proj = (quat_apply(data.root_quat_w, self._forward) * normalize(to_target)).sum(dim=-1)
        self._target_angle = torch.atan2(to_target[:, 1], to_target[:, 0])
        limits = data.soft_joint_pos_limits
        self._scaled_pos = scale_transform(data.joint_pos, limits[..., 0], limits[..., 1])

    def _progress(self) -> torch.Tensor:
        """Speed at which the distance to the target shrank over the last step [m/s], shape ``(num_envs,)``.

        ``|a| - |b| = (a - b) . (a + b) / (|a| + |b|)``: the plain difference of two distances of a kilometre has steps
        of 4 mm/s in float32.
        """
        pos, target = self.robot.data.root_pos_w[:, :2], self._target[:, :2]
        before, now = target - self._last_pos, target - pos
        total = torch.linalg.vector_norm(before, dim=-1) + torch.linalg.vector_norm(now, dim=-1)
        progress = ((pos - self._last_pos) * (before + now)).sum(dim=-1) / (total * self.step_dt)
        self._last_pos = pos.clone()
        return progress

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        self._compute_torso_relations()
        time_out = self.episode_length_buf >= self.max_episode_length
        height = self.robot.data.root_pos_w[:, 2] - self.scene.env_origins[:, 2]  # of the storey of a scenery
        return height < self.cfg.termination_height, time_out

    def _get_rewards(self) -> torch.Tensor:
        cfg, data = self.cfg, self.robot.data
        heading = cfg.heading_weight * (self._heading_proj / 0.8).clamp(max=1.0)
        upright = cfg.up_weight * (self._up_proj > 0.93)
        effort = cfg.actions_cost * self.actions.square().sum(dim=-1)
        power = self.actions * data.joint_vel * cfg.joint_vel_scale * self._gear_ratio
        power = cfg.power_cost * power.abs().sum(dim=-1)
        at_limit = cfg.at_limit_cost * (self._scaled_pos.abs() > 0.98).sum(dim=-1)
        progress = self._progress()
        total = progress + cfg.alive_reward + upright + heading - effort - power - at_limit
        self.extras["log"]["Episode_Reward/progress"] = progress.mean()
        return torch.where(self.reset_terminated, cfg.death_cost, total)

    def _get_observations(self) -> dict[str, torch.Tensor]:
        data, cfg = self.robot.data, self.cfg
        roll, _, yaw = euler_xyz_from_quat(data.root_quat_w)
        angle = wrap_to_pi(self._target_angle - yaw)
        scalars = (yaw, roll, angle, self._up_proj, self._heading_proj)
        observations = torch.cat(
            (
                data.root_pos_w[:, 2:3],
                quat_apply_inverse(data.root_quat_w, data.root_lin_vel_w),
                quat_apply_inverse(data.root_quat_w, data.root_ang_vel_w) * cfg.ang_vel_scale,
                torch.stack(scalars, dim=-1),
                self._scaled_pos,
                data.joint_vel * cfg.joint_vel_scale,
                self.actions,
            ),
            dim=-1,
        )
        return {"policy": observations}

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        super()._reset_idx(env_ids)
        robot = self.robot
        ids = robot.env_indices(env_ids)
        state = robot.data.default_root_state[ids]
        state[:, :3] += self.scene.env_origins[ids]
        robot.write_root_state_to_sim(state, ids)
        robot.write_joint_state_to_sim(
            robot.data.default_joint_pos[ids], robot.data.default_joint_vel[ids], env_ids=ids
        )
        self.actions[ids] = 0.0
        # progress counts from where the episode starts, not from where the last one ended
        self._last_pos[ids] = robot.data.root_pos_w[ids, :2]
        self._compute_torso_relations()


@configclass
class LocomotionPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for the ant and the humanoid."""

    num_steps_per_env: int = 32
    save_interval: int = 100
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(400, 200, 100),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(400, 200, 100), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.0, learning_rate=5.0e-4)


@configclass
class AntEnvCfg(LocomotionEnvCfg):
    """Direct ant: 36 observations, 8 joint torques."""

    observation_space: int = 36
    action_space: int = 8
    robot: ArticulationCfg = ANT_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    joint_gears: dict[str, float] = {".*": 15.0}
    action_scale: float = 0.5
    termination_height: float = 0.31


class AntEnv(LocomotionEnv):
    """The ant runs; see :class:`LocomotionEnv`."""

    cfg: AntEnvCfg


@configclass
class AntPPORunnerCfg(LocomotionPPORunnerCfg):
    """PPO that makes the ant run."""

    max_iterations: int = 300
    experiment_name: str = "ant_direct"


@configclass
class HumanoidEnvCfg(LocomotionEnvCfg):
    """Direct humanoid: 75 observations, 21 joint torques."""

    observation_space: int = 75
    action_space: int = 21
    robot: ArticulationCfg = HUMANOID_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    joint_gears: dict[str, float] = {
        "lower_waist:.": 67.5,
        "abdomen_x": 67.5,
        ".*_upper_arm:.": 67.5,
        ".*_elbow": 45.0,
        ".*_thigh:[02]": 45.0,
        ".*_thigh:1": 135.0,
        ".*_knee": 90.0,
        ".*_foot:.": 22.5,
    }
    alive_reward: float = 2.0
    death_cost: float = -1.0
    actions_cost: float = 0.01
    joint_vel_scale: float = 0.1
    ang_vel_scale: float = 0.25
    termination_height: float = 0.8


class HumanoidEnv(LocomotionEnv):
    """The humanoid runs; see :class:`LocomotionEnv`."""

    cfg: HumanoidEnvCfg


@configclass
class HumanoidPPORunnerCfg(LocomotionPPORunnerCfg):
    """PPO that makes the humanoid run."""

    max_iterations: int = 500
    experiment_name: str = "humanoid_direct"
