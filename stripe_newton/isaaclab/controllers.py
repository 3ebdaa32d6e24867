# SPDX-License-Identifier: Apache-2.0
"""Controllers of the Isaac Lab dialect: those of stripe_newton with quaternions (w, x, y, z)."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_newton import controllers as native
from stripe_newton.isaaclab.quaternions import pose_to_wxyz, pose_to_xyzw, to_wxyz, to_xyzw

__all__ = ["DifferentialIKController", "OperationalSpaceController"]


class DifferentialIKController(native.DifferentialIKController):
    """Differential inverse kinematics; ``command``, ``ee_quat`` and ``ee_quat_des`` hold (w, x, y, z)."""

    @property
    def ee_quat_des(self) -> torch.Tensor:
        """Desired orientation ``(num_envs, 4)``, read only."""
        return to_wxyz(self._target_quat)

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Isaac Lab's call at resets: the controller keeps nothing but the command, which the next one replaces."""

    def set_command(
        self, command: torch.Tensor, ee_pos: torch.Tensor | None = None, ee_quat: torch.Tensor | None = None
    ) -> None:
        """Set the desired pose; one row is that of all environments."""
        command = command.expand(self.num_envs, -1) if len(command) == 1 else command
        if self.action_dim == 7 and command.shape[-1] == 7:
            command = pose_to_xyzw(command)
        super().set_command(command, ee_pos, None if ee_quat is None else to_xyzw(ee_quat))

    def compute(
        self, ee_pos: torch.Tensor, ee_quat: torch.Tensor, jacobian: torch.Tensor, joint_pos: torch.Tensor
    ) -> torch.Tensor:
        """Joint position targets ``(num_envs, num_joints)`` [m or rad]."""
        return super().compute(ee_pos, to_xyzw(ee_quat), jacobian, joint_pos)


class OperationalSpaceController(native.OperationalSpaceController):
    """Operational space control; poses in commands and arguments hold (w, x, y, z)."""

    @property
    def desired_ee_pose_task(self) -> torch.Tensor | None:
        """Commanded pose ``(num_envs, 7)`` in the task's frame, read only; None before the first command."""
        return None if self._pose_task is None else pose_to_wxyz(self._pose_task)

    @property
    def desired_ee_pose_b(self) -> torch.Tensor | None:
        """Commanded pose ``(num_envs, 7)`` in the root's frame, read only; None before the first command."""
        return None if self._pose_b is None else pose_to_wxyz(self._pose_b)

    def set_command(
        self,
        command: torch.Tensor,
        current_ee_pose_b: torch.Tensor | None = None,
        current_task_frame_pose_b: torch.Tensor | None = None,
    ) -> None:
        """Set targets, and gains where these vary."""
        if command.shape[-1] == self.action_dim:
            sizes = [*self.target_list, self.action_dim - self.target_dim]
            *targets, gains = torch.split(command, sizes, dim=-1)
            # Of the targets, absolute poses alone have seven numbers.
            ordered = [pose_to_xyzw(target) if target.shape[-1] == 7 else target for target in targets]
            command = torch.cat([*ordered, gains], dim=-1)
        super().set_command(command, _pose(current_ee_pose_b), _pose(current_task_frame_pose_b))

    def compute(
        self,
        jacobian_b: torch.Tensor,
        current_ee_pose_b: torch.Tensor | None = None,
        current_ee_vel_b: torch.Tensor | None = None,
        current_ee_force_b: torch.Tensor | None = None,
        mass_matrix: torch.Tensor | None = None,
        gravity: torch.Tensor | None = None,
        current_joint_pos: torch.Tensor | None = None,
        current_joint_vel: torch.Tensor | None = None,
        nullspace_joint_pos_target: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Joint efforts ``(num_envs, num_joints)`` [N or N m]."""
        return super().compute(
            jacobian_b,
            _pose(current_ee_pose_b),
            current_ee_vel_b,
            current_ee_force_b,
            mass_matrix,
            gravity,
            current_joint_pos,
            current_joint_vel,
            nullspace_joint_pos_target,
        )


def _pose(pose: torch.Tensor | None) -> torch.Tensor | None:
    """A pose (w, x, y, z), if any, in the order of stripe_newton."""
    return None if pose is None else pose_to_xyzw(pose)
