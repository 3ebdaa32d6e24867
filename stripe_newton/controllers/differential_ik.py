# SPDX-License-Identifier: Apache-2.0
"""Differential inverse kinematics controller: joint positions that move a body to a commanded pose.

Source: S. R. Buss, "Introduction to Inverse Kinematics with Jacobian Transpose, Pseudoinverse and Damped Least Squares
methods", University of California, San Diego, 2004.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.math import apply_delta_pose, compute_pose_error

__all__ = ["DifferentialIKController", "DifferentialIKControllerCfg"]

_IK_PARAMS: dict[str, dict[str, float]] = {
    "pinv": {"k_val": 1.0},
    "svd": {"k_val": 1.0, "min_singular_value": 1e-5},
    "trans": {"k_val": 1.0},
    "dls": {"lambda_val": 0.01},
}


@configclass
class DifferentialIKControllerCfg:
    """Config of differential inverse kinematics: joint positions that move a body to a commanded pose."""

    command_type: str = MISSING
    """``"position"``, or ``"pose"`` to command the rotation too."""
    use_relative_mode: bool = False
    """Commands are changes of the current pose rather than poses."""
    ik_method: str = MISSING
    """``"pinv"`` (pseudo-inverse of the Jacobian), ``"svd"`` (the same without small singular values), ``"trans"``
    (its transpose) or ``"dls"`` (damped least squares)."""
    ik_params: dict[str, float] | None = None
    """Parameters of the method: ``k_val``, the gain of ``pinv``, ``svd`` and ``trans`` (default 1);
    ``min_singular_value`` of ``svd`` (1e-5); ``lambda_val``, the damping of ``dls`` (0.01)."""

    @property
    def action_dim(self) -> int:
        """Size of a command: position [m], and for poses a quaternion (x, y, z, w) or a rotation vector [rad]."""
        return 3 if self.command_type == "position" else 6 if self.use_relative_mode else 7

    @property
    def numbers(self) -> dict[str, float]:
        """``ik_params`` completed by the defaults of the method."""
        return _IK_PARAMS.get(self.ik_method, {}) | (self.ik_params or {})

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield invalid fields as ``(field, message)``."""
        if self.command_type not in ("position", "pose", MISSING):
            yield "command_type", f"is '{self.command_type}', must be 'position' or 'pose'"
        if self.ik_method is MISSING:
            return
        if self.ik_method not in _IK_PARAMS:
            yield "ik_method", f"is '{self.ik_method}', must be one of {', '.join(map(repr, _IK_PARAMS))}"
            return
        known = _IK_PARAMS[self.ik_method]
        for name, value in (self.ik_params or {}).items():
            if name not in known:
                yield f"ik_params[{name!r}]", f"'{self.ik_method}' has no such number, it takes {', '.join(known)}"
            elif not (math.isfinite(value) and value > 0.0):
                yield f"ik_params[{name!r}]", f"is {value}, must be above 0 and finite"


class DifferentialIKController:
    """Differential inverse kinematics, ``q* = q + J^+ e``, for a batch of robots.

    Poses, commands and Jacobians are all in one frame, usually the root's, which the controller need not know.
    """

    def __init__(self, cfg: DifferentialIKControllerCfg, num_envs: int, device: str | torch.device):
        """Build the controller.

        Args:
            cfg: Kind of command and method.
            num_envs: Number of robots.
            device: Device of the tensors.

        Raises:
            ConfigError: if the config is not valid.
        """
        cfg.validate()
        self.cfg = cfg
        self.num_envs = num_envs
        self.device = device
        self._target_pos = torch.zeros(num_envs, 3, device=device)
        self._target_quat = torch.zeros(num_envs, 4, device=device)

    @property
    def action_dim(self) -> int:
        """Size of a command: 3, 6 or 7."""
        return self.cfg.action_dim

    @property
    def ee_pos_des(self) -> torch.Tensor:
        """Desired position ``(num_envs, 3)`` [m] of the last command; zero before the first."""
        return self._target_pos

    @property
    def ee_quat_des(self) -> torch.Tensor:
        """Desired orientation ``(num_envs, 4)`` of the last command, (x, y, z, w); zero before the first."""
        return self._target_quat

    def set_command(
        self, command: torch.Tensor, ee_pos: torch.Tensor | None = None, ee_quat: torch.Tensor | None = None
    ) -> None:
        """Set the desired pose.

        Args:
            command: Position ``(num_envs, 3)`` [m], or pose ``(num_envs, 7)`` with a quaternion (x, y, z, w). Relative
                ones are a shift ``(num_envs, 3)`` [m], or shift and rotation vector ``(num_envs, 6)`` [m, rad].
            ee_pos: Position now ``(num_envs, 3)`` [m], for relative commands.
            ee_quat: Orientation now ``(num_envs, 4)``, for relative poses and for all positions, which keep it.

        Raises:
            ValueError: if the command has another shape, or what it needs is missing.
        """
        if command.shape != (self.num_envs, self.action_dim):
            expected = (self.num_envs, self.action_dim)
            raise ValueError(f"set_command: expected a command of shape {expected}, got {tuple(command.shape)}")
        is_position = self.cfg.command_type == "position"
        if ee_pos is None and self.cfg.use_relative_mode:
            raise ValueError("set_command: ee_pos is missing, which relative commands start from")
        if ee_quat is None and (is_position or self.cfg.use_relative_mode):
            raise ValueError("set_command: ee_quat is missing, which positions keep and relative poses start from")
        # Copies: the caller may go on to write its tensors in place.
        if is_position and ee_quat is not None:
            self._target_pos, self._target_quat = command.clone(), ee_quat.clone()
            if self.cfg.use_relative_mode and ee_pos is not None:
                self._target_pos += ee_pos
        elif self.cfg.use_relative_mode and ee_pos is not None and ee_quat is not None:
            self._target_pos, self._target_quat = apply_delta_pose(ee_pos, ee_quat, command)
        else:
            self._target_pos, self._target_quat = command[:, :3].clone(), command[:, 3:].clone()

    def compute(
        self, ee_pos: torch.Tensor, ee_quat: torch.Tensor, jacobian: torch.Tensor, joint_pos: torch.Tensor
    ) -> torch.Tensor:
        """Joint position targets ``(num_envs, num_joints)`` [m or rad].

        Args:
            ee_pos: Position now ``(num_envs, 3)`` [m].
            ee_quat: Orientation now ``(num_envs, 4)``, (x, y, z, w).
            jacobian: Jacobian of that point ``(num_envs, 6, num_joints)``, linear rows first.
            joint_pos: Joint positions now ``(num_envs, num_joints)`` [m or rad].
        """
        if self.cfg.command_type == "position":
            error, jacobian = self._target_pos - ee_pos, jacobian[:, :3]
        else:
            error = torch.cat(compute_pose_error(ee_pos, ee_quat, self._target_pos, self._target_quat), dim=-1)
        return joint_pos + (self._inverse(jacobian) @ error.unsqueeze(-1)).squeeze(-1)

    def _inverse(self, jacobian: torch.Tensor) -> torch.Tensor:
        """Matrices ``(num_envs, num_joints, rows)`` that map errors to changes of the joints."""
        numbers, method = self.cfg.numbers, self.cfg.ik_method
        if method == "pinv":
            return numbers["k_val"] * torch.linalg.pinv(jacobian)
        if method == "trans":
            return numbers["k_val"] * jacobian.mT
        if method == "svd":
            u, s, vh = torch.linalg.svd(jacobian, full_matrices=False)
            inverse = torch.where(s > numbers["min_singular_value"], 1.0 / s, torch.zeros_like(s))
            return numbers["k_val"] * (vh.mT * inverse.unsqueeze(-2)) @ u.mT
        unit = torch.eye(jacobian.shape[1], dtype=jacobian.dtype, device=jacobian.device)
        # The matrix is symmetric, so that the solution transposed is the product with the inverse.
        return torch.linalg.solve(jacobian @ jacobian.mT + numbers["lambda_val"] ** 2 * unit, jacobian).mT
