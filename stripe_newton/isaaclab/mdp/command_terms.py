# SPDX-License-Identifier: Apache-2.0
"""Classes of the commands of ``isaaclab.envs.mdp``, for subclasses.

Commands of the classes themselves are drawn by kernels. A subclass runs in torch, with the attributes that Isaac Lab's
classes have, on the same formulas. Quaternions are (w, x, y, z).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_newton.managers import CommandTerm, TermEnv
from stripe_newton.managers.commands_cfg import (
    NormalVelocityCommandCfg,
    UniformPose2dCommandCfg,
    UniformPoseCommandCfg,
    UniformVelocityCommandCfg,
)

from .. import math

__all__ = [
    "NormalVelocityCommand",
    "NullCommand",
    "TerrainBasedPose2dCommand",
    "UniformPose2dCommand",
    "UniformPoseCommand",
    "UniformVelocityCommand",
]

EnvIds = Sequence[int] | torch.Tensor


class _Known(CommandTerm):
    """A command that has kernels: a class with nothing of its own but its name is run by them."""

    def __init_subclass__(cls, fused: bool = False):
        """With ``fused`` the class is one that has kernels."""
        cls._fused = fused

    _fused: bool = False

    @classmethod
    def is_fused(cls) -> bool:
        """Whether kernels draw the command."""
        return cls._fused

    def __init__(self, cfg: object, env: TermEnv):
        """Find the robot."""
        super().__init__(cfg, env)  # type: ignore[arg-type]  # the config of the subclass
        self.robot = env.scene[self.cfg.asset_name]

    def _zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        return torch.zeros(self.num_envs, *shape, dtype=dtype, device=self.device)

    def _uniform(self, env_ids: EnvIds, bounds: tuple[float, float]) -> torch.Tensor:
        return torch.empty(len(env_ids), device=self.device).uniform_(*bounds)


class NullCommand(_Known, fused=True):
    """No command."""

    def __init__(self, cfg: object, env: TermEnv):
        CommandTerm.__init__(self, cfg, env)  # type: ignore[arg-type]  # it names no robot

    @property
    def command(self) -> torch.Tensor:
        """There is none.

        Raises:
            RuntimeError: always.
        """
        raise RuntimeError("a NullCommand has no numbers")

    def reset(self, env_ids: EnvIds | None = None) -> dict[str, torch.Tensor]:
        """Nothing."""
        return {}

    def compute(self, dt: float) -> None:
        """Nothing."""


class _VelocityCommand(_Known):
    """Base of velocity commands.

    Attributes:
        vel_command_b: The command, shape ``(num_envs, 3)`` [m/s, m/s, rad/s].
        is_standing_env: Where it is zero, shape ``(num_envs,)``.
    """

    def __init__(self, cfg: object, env: TermEnv):
        super().__init__(cfg, env)
        self.vel_command_b = self._zeros(3)
        self.is_standing_env = self._zeros(dtype=torch.bool)
        self.metrics = {"error_vel_xy": self._zeros(), "error_vel_yaw": self._zeros()}

    @property
    def command(self) -> torch.Tensor:
        """The command, shape ``(num_envs, 3)``."""
        return self.vel_command_b

    def _update_metrics(self) -> None:
        """Add the errors, as means over the longest time that a command may hold."""
        steps = self.cfg.resampling_time_range[1] / self._env.step_dt
        data, wanted = self.robot.data, self.vel_command_b
        self.metrics["error_vel_xy"] += (wanted[:, :2] - data.root_lin_vel_b[:, :2]).norm(dim=-1) / steps
        self.metrics["error_vel_yaw"] += (wanted[:, 2] - data.root_ang_vel_b[:, 2]).abs() / steps


class UniformVelocityCommand(_VelocityCommand, fused=True):
    """Uniform velocity commands.

    Attributes:
        heading_target: Headings [rad], shape ``(num_envs,)``.
        is_heading_env: Where the yaw rate follows from the heading, shape ``(num_envs,)``.
    """

    cfg: UniformVelocityCommandCfg

    def __init__(self, cfg: object, env: TermEnv):
        super().__init__(cfg, env)
        self.heading_target, self.is_heading_env = self._zeros(), self._zeros(dtype=torch.bool)

    def _resample_command(self, env_ids: EnvIds) -> None:
        cfg, ranges = self.cfg, self.cfg.ranges
        for column, bounds in enumerate((ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z)):
            self.vel_command_b[env_ids, column] = self._uniform(env_ids, bounds)
        if cfg.heading_command:
            assert ranges.heading is not None  # checked by the config
            self.heading_target[env_ids] = self._uniform(env_ids, ranges.heading)
            self.is_heading_env[env_ids] = self._uniform(env_ids, (0.0, 1.0)) <= cfg.rel_heading_envs
        self.is_standing_env[env_ids] = self._uniform(env_ids, (0.0, 1.0)) <= cfg.rel_standing_envs

    def _update_command(self) -> None:
        if self.cfg.heading_command:
            error = math.wrap_to_pi(self.heading_target - self.robot.data.heading_w)
            rate = (self.cfg.heading_control_stiffness * error).clamp(*self.cfg.ranges.ang_vel_z)
            self.vel_command_b[:, 2] = torch.where(self.is_heading_env, rate, self.vel_command_b[:, 2])
        self.vel_command_b[self.is_standing_env] = 0.0


class NormalVelocityCommand(_VelocityCommand, fused=True):
    """Normal velocity commands.

    Attributes:
        is_zero_vel_x_env: Where the forward velocity is zero, shape ``(num_envs,)``.
        is_zero_vel_y_env: Where the sideways velocity is zero, shape ``(num_envs,)``.
        is_zero_vel_yaw_env: Where the yaw rate is zero, shape ``(num_envs,)``.
    """

    cfg: NormalVelocityCommandCfg

    def __init__(self, cfg: object, env: TermEnv):
        super().__init__(cfg, env)
        self.is_zero_vel_x_env, self.is_zero_vel_y_env, self.is_zero_vel_yaw_env = (
            self._zeros(dtype=torch.bool) for _ in range(3)
        )

    @property
    def _is_zero(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        return self.is_zero_vel_x_env, self.is_zero_vel_y_env, self.is_zero_vel_yaw_env

    def _resample_command(self, env_ids: EnvIds) -> None:
        ranges, count = self.cfg.ranges, len(env_ids)
        for column, (mean, deviation) in enumerate(zip(ranges.mean_vel, ranges.std_vel, strict=True)):
            drawn = torch.empty(count, device=self.device).normal_(mean, deviation)
            sign = 2.0 * torch.randint(0, 2, (count,), device=self.device) - 1.0
            self.vel_command_b[env_ids, column] = sign * drawn
        for is_zero, chance in zip(self._is_zero, ranges.zero_prob, strict=True):
            is_zero[env_ids] = self._uniform(env_ids, (0.0, 1.0)) <= chance
        self.is_standing_env[env_ids] = self._uniform(env_ids, (0.0, 1.0)) <= self.cfg.rel_standing_envs

    def _update_command(self) -> None:
        for column, is_zero in enumerate(self._is_zero):
            self.vel_command_b[is_zero | self.is_standing_env, column] = 0.0


class UniformPoseCommand(_Known, fused=True):
    """Uniform pose commands for a body.

    Attributes:
        body_idx: Index of the body.
        pose_command_b: Poses in the root's frame, shape ``(num_envs, 7)``.
        pose_command_w: The same in the world, of the last step.
    """

    cfg: UniformPoseCommandCfg

    def __init__(self, cfg: object, env: TermEnv):
        super().__init__(cfg, env)
        self.body_idx = self.robot.find_bodies(self.cfg.body_name)[0][0]
        self.pose_command_b, self.pose_command_w = self._zeros(7), self._zeros(7)
        self.pose_command_b[:, 3] = 1.0
        self.metrics = {"position_error": self._zeros(), "orientation_error": self._zeros()}

    @property
    def command(self) -> torch.Tensor:
        """The command, shape ``(num_envs, 7)``."""
        return self.pose_command_b

    def _resample_command(self, env_ids: EnvIds) -> None:
        ranges = self.cfg.ranges
        for column, bounds in enumerate((ranges.pos_x, ranges.pos_y, ranges.pos_z)):
            self.pose_command_b[env_ids, column] = self._uniform(env_ids, bounds)
        angles = (self._uniform(env_ids, bounds) for bounds in (ranges.roll, ranges.pitch, ranges.yaw))
        turn = math.quat_from_euler_xyz(*angles)
        self.pose_command_b[env_ids, 3:] = math.quat_unique(turn) if self.cfg.make_quat_unique else turn

    def _update_command(self) -> None:
        """Nothing: the command holds."""

    def _update_metrics(self) -> None:
        """Set the errors of this step."""
        data, local = self.robot.data, self.pose_command_b
        pos, turn = math.combine_frame_transforms(data.root_pos_w, data.root_quat_w, local[:, :3], local[:, 3:])
        self.pose_command_w[:] = torch.cat((pos, turn), dim=-1)
        body = data.body_pos_w[:, self.body_idx], data.body_quat_w[:, self.body_idx]
        shift, rotation = math.compute_pose_error(pos, turn, *body)
        self.metrics["position_error"] = shift.norm(dim=-1)
        self.metrics["orientation_error"] = rotation.norm(dim=-1)


class UniformPose2dCommand(_Known, fused=True):
    """Uniform positions on the ground, with a heading.

    Attributes:
        pos_command_w: Positions in the world [m], shape ``(num_envs, 3)``.
        heading_command_w: Headings in the world [rad], shape ``(num_envs,)``.
        pos_command_b: Positions relative to the root, in its yaw frame, shape ``(num_envs, 3)``.
        heading_command_b: Headings relative to the root's, shape ``(num_envs,)``.
    """

    cfg: UniformPose2dCommandCfg

    def __init__(self, cfg: object, env: TermEnv):
        super().__init__(cfg, env)
        self.pos_command_w, self.pos_command_b = self._zeros(3), self._zeros(3)
        self.heading_command_w, self.heading_command_b = self._zeros(), self._zeros()
        self.metrics = {"error_pos_2d": self._zeros(), "error_heading": self._zeros()}

    @property
    def command(self) -> torch.Tensor:
        """Position and heading relative to the root, shape ``(num_envs, 4)``."""
        return torch.cat((self.pos_command_b, self.heading_command_b.unsqueeze(-1)), dim=-1)

    def _draw_positions(self, env_ids: EnvIds) -> torch.Tensor:
        """Positions [m], shape ``(n, 3)``, at the height where the root stands by default."""
        ranges, origins = self.cfg.ranges, self._env.scene.env_origins[env_ids]
        x, y = self._uniform(env_ids, ranges.pos_x), self._uniform(env_ids, ranges.pos_y)
        return origins + torch.stack((x, y, self.robot.data.default_root_state[env_ids, 2]), dim=-1)

    def _resample_command(self, env_ids: EnvIds) -> None:
        self.pos_command_w[env_ids] = self._draw_positions(env_ids)
        if not self.cfg.simple_heading:
            self.heading_command_w[env_ids] = self._uniform(env_ids, self.cfg.ranges.heading)
            return
        way = self.pos_command_w[env_ids] - self.robot.data.root_pos_w[env_ids]
        ahead = torch.atan2(way[:, 1], way[:, 0])
        back = math.wrap_to_pi(ahead + torch.pi)
        now = self.robot.data.heading_w[env_ids]
        turns = [math.wrap_to_pi(heading - now).abs() for heading in (ahead, back)]
        self.heading_command_w[env_ids] = torch.where(turns[0] < turns[1], ahead, back)

    def _update_command(self) -> None:
        data = self.robot.data
        way = self.pos_command_w - data.root_pos_w[:, :3]
        self.pos_command_b[:] = math.quat_apply_inverse(math.yaw_quat(data.root_quat_w), way)
        self.heading_command_b[:] = math.wrap_to_pi(self.heading_command_w - data.heading_w)

    def _update_metrics(self) -> None:
        """Set the errors of this step."""
        data = self.robot.data
        self.metrics["error_pos_2d"] = (self.pos_command_w[:, :2] - data.root_pos_w[:, :2]).norm(dim=-1)
        self.metrics["error_heading"] = math.wrap_to_pi(self.heading_command_w - data.heading_w).abs()


class TerrainBasedPose2dCommand(UniformPose2dCommand, fused=True):
    """Positions among the flat patches ``"target"`` of each environment's terrain, with a heading.

    Attributes:
        terrain: The terrain.
        valid_targets: Its patches [m], shape ``(levels, types, num_patches, 3)``.
    """

    def __init__(self, cfg: object, env: TermEnv):
        """Find the patches.

        Raises:
            RuntimeError: the terrain has none of this name.
        """
        super().__init__(cfg, env)
        self.terrain = env.scene["terrain"]
        if "target" not in self.terrain.flat_patches:
            there = ", ".join(self.terrain.flat_patches) or "none"
            raise RuntimeError(f"the terrain has no flat patches 'target'; there is {there}")
        self.valid_targets = self.terrain.flat_patches["target"]

    def _draw_positions(self, env_ids: EnvIds) -> torch.Tensor:
        ids = torch.as_tensor(env_ids, device=self.device)
        level, kind = self.terrain.terrain_levels[ids], self.terrain.terrain_types[ids]
        patch = torch.randint(0, self.valid_targets.shape[2], (len(ids),), device=self.device)
        pos = self.valid_targets[level, kind, patch].clone()
        pos[:, 2] += self.robot.data.default_root_state[ids, 2]
        return pos
