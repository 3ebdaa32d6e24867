# SPDX-License-Identifier: Apache-2.0
"""Command terms as classes: those that a user writes in torch, and views of those of kernels."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_kernels.data import CommandData, Pose2dCommandData, PoseCommandData, VelocityCommandData
from stripe_kernels.motion import MotionCommandData
from stripe_newton.fusion.warp_types import is_instance

from .commands_cfg import CommandTermCfg
from .context import ManagerContext
from .term_class import ManagerTermBase, TermEnv

__all__ = [
    "CommandTerm",
    "KernelCommandTerm",
    "KernelMotionCommandTerm",
    "KernelPose2dCommandTerm",
    "KernelPoseCommandTerm",
    "KernelVelocityCommandTerm",
    "view_of",
]

EnvIds = Sequence[int] | torch.Tensor


class CommandTerm(ManagerTermBase):
    """Base of command terms in torch.

    ``CommandTermCfg.class_type`` names the class. A subclass gives :attr:`command`, :meth:`_resample_command`,
    :meth:`_update_command` and :meth:`_update_metrics`. Metrics are logged as ``Metrics/<command>/<metric>``: the mean
    over the environments whose episodes end.

    Attributes:
        cfg: The config.
        metrics: Tensors ``(num_envs,)`` by name.
        time_left: Time until a new command is drawn [s], shape ``(num_envs,)``.
        command_counter: Commands drawn in the episode, int64, shape ``(num_envs,)``.
    """

    cfg: CommandTermCfg

    def __init__(self, cfg: CommandTermCfg, env: TermEnv):
        """Make the clock and the counter."""
        super().__init__(cfg, env)
        self.metrics: dict[str, torch.Tensor] = {}
        self.time_left = torch.zeros(self.num_envs, device=self.device)
        self.command_counter = torch.zeros(self.num_envs, dtype=torch.long, device=self.device)

    @property
    def command(self) -> torch.Tensor:
        """The command, shape ``(num_envs, n)``."""
        raise NotImplementedError(f"{type(self).__name__} has no command")

    def reset(self, env_ids: EnvIds | None = None) -> dict[str, torch.Tensor]:
        """Begin episodes in the environments ``env_ids``, None for all; returns the means of their metrics."""
        ids = torch.arange(self.num_envs, device=self.device) if env_ids is None else env_ids
        means = {name: values[ids].float().mean() for name, values in self.metrics.items()}
        for values in self.metrics.values():
            values[ids] = 0.0
        self.command_counter[ids] = 0
        self._resample(ids)
        return means

    def compute(self, dt: float) -> None:
        """Advance the command by a step of ``dt`` [s]."""
        self._update_metrics()
        self.time_left -= dt
        due = (self.time_left <= 0.0).nonzero().flatten()
        if len(due):
            self._resample(due)
        self._update_command()

    def _resample(self, env_ids: EnvIds) -> None:
        """Draw commands for environments, and the times for which they hold."""
        if len(env_ids):
            low, high = self.cfg.resampling_time_range
            drawn = torch.empty(len(env_ids), device=self.device).uniform_(low, high)
            self.time_left[env_ids] = drawn
            self._resample_command(env_ids)
            self.command_counter[env_ids] += 1

    def _resample_command(self, env_ids: EnvIds) -> None:
        """Draw commands for the environments ``env_ids``."""
        raise NotImplementedError(f"{type(self).__name__} has no _resample_command")

    def _update_command(self) -> None:
        """Change commands that depend on the state; called in every step, after resampling."""
        raise NotImplementedError(f"{type(self).__name__} has no _update_command")

    def _update_metrics(self) -> None:
        """Compute the metrics on the state of this step, and the commands that held in it."""
        raise NotImplementedError(f"{type(self).__name__} has no _update_metrics")


class KernelCommandTerm(CommandTerm):
    """View of a command term of kernels, which draw and update the command as a part of the step.

    Numbers of its ``cfg`` may be changed in place.
    """

    def __init__(self, cfg: CommandTermCfg, context: ManagerContext, data: CommandData):
        super().__init__(cfg, context.env)
        self._command = context.torch(data.command)
        self.time_left, self._counter = context.torch(data.time_left), context.torch(data.counter)

    @property
    def command(self) -> torch.Tensor:
        """The command, shape ``(num_envs, n)``, in the memory of the step."""
        return self._command

    @property
    def command_counter(self) -> torch.Tensor:
        """Commands drawn in the episode, int64, shape ``(num_envs,)``."""
        return self._counter.long()

    @command_counter.setter
    def command_counter(self, value: torch.Tensor) -> None:
        """The base class's; the counter is that of the kernels."""


class KernelVelocityCommandTerm(KernelCommandTerm):
    """View of a velocity command.

    Attributes:
        vel_command_b: The command, shape ``(num_envs, 3)`` [m/s, m/s, rad/s].
        heading_target: Headings in the world [rad], shape ``(num_envs,)``.
        is_heading_env: Where the yaw rate follows from the heading, shape ``(num_envs,)``.
        is_standing_env: Where the command is to stand, shape ``(num_envs,)``.
    """

    def __init__(self, cfg: CommandTermCfg, context: ManagerContext, data: CommandData, velocity: VelocityCommandData):
        super().__init__(cfg, context, data)
        self.vel_command_b = self.command
        self.heading_target, self.is_heading_env, self.is_standing_env = (
            context.torch(array) for array in (velocity.heading_target, velocity.is_heading, velocity.is_standing)
        )


class KernelPose2dCommandTerm(KernelCommandTerm):
    """View of a position command.

    Attributes:
        pos_command_w: Positions in the world [m], shape ``(num_envs, 3)``.
        heading_command_w: Headings in the world [rad], shape ``(num_envs,)``.
    """

    def __init__(self, cfg: CommandTermCfg, context: ManagerContext, data: CommandData, place: Pose2dCommandData):
        super().__init__(cfg, context, data)
        self.pos_command_w, self.heading_command_w = context.torch(place.pos), context.torch(place.heading)

    @property
    def pos_command_b(self) -> torch.Tensor:
        """Positions relative to the root, in its yaw frame [m], shape ``(num_envs, 3)``."""
        return self.command[:, :3]

    @property
    def heading_command_b(self) -> torch.Tensor:
        """Headings relative to the root's [rad], shape ``(num_envs,)``."""
        return self.command[:, 3]


class KernelPoseCommandTerm(KernelCommandTerm):
    """View of a pose command."""

    @property
    def pose_command_b(self) -> torch.Tensor:
        """Poses in the root's frame, shape ``(num_envs, 7)``, as the command has them."""
        return self.command


class KernelMotionCommandTerm(KernelCommandTerm):
    """View of a motion command.

    Attributes:
        frame: Frames that the robots are to reach by the end of the next step, among those of all motions, int32,
            shape ``(num_envs,)``.
        start: Frames at which the episodes began, int32, shape ``(num_envs,)``.
        body_pose: Poses of the bodies in all frames, relative to the environment's origin [m], (x, y, z, w), shape
            ``(num_frames, num_bodies, 7)``.
        failure_rate: Averaged failures of the bins, shape ``(num_bins,)``.
    """

    def __init__(self, cfg: CommandTermCfg, context: ManagerContext, data: CommandData, motion: MotionCommandData):
        super().__init__(cfg, context, data)
        self.frame, self.start, self.body_pose, self.failure_rate = (
            context.torch(array) for array in (motion.frame, motion.start, motion.body_pose, motion.failure_rate)
        )

    @property
    def joint_pos(self) -> torch.Tensor:
        """Joint positions of the reference [rad], shape ``(num_envs, num_joints)``."""
        return self.command[:, : self.command.shape[1] // 2]

    @property
    def joint_vel(self) -> torch.Tensor:
        """Joint velocities of the reference [rad/s], shape ``(num_envs, num_joints)``."""
        return self.command[:, self.command.shape[1] // 2 :]


def view_of(cfg: CommandTermCfg, context: ManagerContext, data: CommandData, struct: object) -> KernelCommandTerm:
    """The view of a command of kernels, by the struct of its kind."""
    if is_instance(struct, VelocityCommandData):
        return KernelVelocityCommandTerm(cfg, context, data, struct)
    if is_instance(struct, Pose2dCommandData):
        return KernelPose2dCommandTerm(cfg, context, data, struct)
    if is_instance(struct, MotionCommandData):
        return KernelMotionCommandTerm(cfg, context, data, struct)
    kind = KernelPoseCommandTerm if is_instance(struct, PoseCommandData) else KernelCommandTerm
    return kind(cfg, context, data)
