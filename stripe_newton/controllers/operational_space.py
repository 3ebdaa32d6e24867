# SPDX-License-Identifier: Apache-2.0
"""Operational space controller: joint efforts for motion and force of a body.

Source: O. Khatib, "A unified approach for motion and force control of robot manipulators: The operational space
formulation", IEEE J. Robotics and Automation 3(1), 1987.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_newton.math import (
    apply_delta_pose,
    combine_frame_transforms,
    compute_pose_error,
    matrix_from_quat,
    subtract_frame_transforms,
)

from .operational_space_cfg import TARGET_SIZES, OperationalSpaceControllerCfg

__all__ = ["OperationalSpaceController"]


class OperationalSpaceController:
    """Operational space control of a batch of robots.

    Efforts are ``J^T (S_m L (K e - D v) + S_f f) + g`` and those of the null space, with the inertia felt at the body
    ``L = (J M^-1 J^T)^-1``, or 1 without decoupling. Poses, velocities and Jacobians are in the root's frame, ``_b``;
    targets are in the task's frame, ``_task``, whose pose in the root's frame comes with the command. Poses are
    positions [m] and quaternions (x, y, z, w).
    """

    def __init__(self, cfg: OperationalSpaceControllerCfg, num_envs: int, device: str | torch.device):
        """Build the controller.

        Args:
            cfg: Targets, gains and what is compensated.
            num_envs: Number of robots.
            device: Device of the tensors.

        Raises:
            ConfigError: if the config is not valid.
        """
        cfg.validate()
        self.cfg = cfg
        self.num_envs = num_envs
        self.device = device
        self.target_list = [TARGET_SIZES[name] for name in cfg.target_types]
        """Size of each target."""
        self.target_dim = sum(self.target_list)
        """Size of all targets."""
        self._motion_axes = self._six(cfg.motion_control_axes_task)
        self._force_axes = self._six(cfg.contact_wrench_control_axes_task)
        self._stiffness = self._six(cfg.motion_stiffness_task)
        self._damping_ratio = self._six(cfg.motion_damping_ratio_task)
        self._pose_task: torch.Tensor | None = None
        self._pose_b: torch.Tensor | None = None
        self.desired_ee_wrench_task: torch.Tensor | None = None
        """Commanded force and torque ``(num_envs, 6)`` [N, N m], at the task frame's origin and along its axes."""
        self.desired_ee_wrench_b: torch.Tensor | None = None
        """The same at the root's origin and along its axes."""
        self._turn = torch.eye(3, device=device).repeat(num_envs, 1, 1)

    @property
    def action_dim(self) -> int:
        """Size of a command: targets, then stiffness and damping ratio where these vary."""
        return self.target_dim + {"fixed": 0, "variable_kp": 6, "variable": 12}[self.cfg.impedance_mode]

    @property
    def desired_ee_pose_task(self) -> torch.Tensor | None:
        """Commanded pose ``(num_envs, 7)`` in the task's frame; None before the first command."""
        return self._pose_task

    @property
    def desired_ee_pose_b(self) -> torch.Tensor | None:
        """Commanded pose ``(num_envs, 7)`` in the root's frame; None before the first command."""
        return self._pose_b

    def reset(self) -> None:
        """Forget the targets: until the next command nothing but gravity and null space is controlled."""
        self._pose_task = self._pose_b = None
        self.desired_ee_wrench_task = self.desired_ee_wrench_b = None

    def set_command(
        self,
        command: torch.Tensor,
        current_ee_pose_b: torch.Tensor | None = None,
        current_task_frame_pose_b: torch.Tensor | None = None,
    ) -> None:
        """Set targets, and gains where these vary.

        Args:
            command: ``(num_envs, action_dim)``: the targets in the order of ``target_types``, then six stiffnesses and
                six damping ratios where these vary. A target is a pose, a shift and a rotation vector [m, rad], or a
                wrench [N, N m].
            current_ee_pose_b: Pose of the body ``(num_envs, 7)``, for relative targets.
            current_task_frame_pose_b: Pose of the task's frame ``(num_envs, 7)``; None means the root's frame.

        Raises:
            ValueError: if the command has another shape, or the pose is missing.
        """
        if command.shape != (self.num_envs, self.action_dim):
            expected = (self.num_envs, self.action_dim)
            raise ValueError(f"set_command: expected a command of shape {expected}, got {tuple(command.shape)}")
        frame = current_task_frame_pose_b
        if frame is None:
            frame = torch.tensor([0.0, 0, 0, 0, 0, 0, 1], device=self.device).repeat(self.num_envs, 1)
        if self.cfg.impedance_mode != "fixed":
            gains = command[:, self.target_dim :]
            self._stiffness = gains[:, :6].clamp(*self.cfg.motion_stiffness_limits_task)
        if self.cfg.impedance_mode == "variable":
            self._damping_ratio = gains[:, 6:].clamp(*self.cfg.motion_damping_ratio_limits_task)
        self._turn = matrix_from_quat(frame[:, 3:])
        targets = torch.split(command[:, : self.target_dim], self.target_list, dim=1)
        for name, target in zip(self.cfg.target_types, targets):
            if name == "wrench_abs":
                self._set_wrench(target, frame)
            else:
                self._set_pose(target, frame, current_ee_pose_b if name == "pose_rel" else None, name == "pose_rel")

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
        """Joint efforts ``(num_envs, num_joints)`` [N or N m].

        Args:
            jacobian_b: Jacobian of the body's point ``(num_envs, 6, num_joints)``, linear rows first.
            current_ee_pose_b: Pose of the body ``(num_envs, 7)``, for motion.
            current_ee_vel_b: Linear and angular velocity of the body ``(num_envs, 6)`` [m/s, rad/s], for motion.
            current_ee_force_b: Force at the contact ``(num_envs, 3)`` [N], for feedback of forces.
            mass_matrix: ``(num_envs, num_joints, num_joints)`` [kg or kg m^2], for decoupling.
            gravity: Efforts that hold the robot against gravity ``(num_envs, num_joints)`` [N or N m].
            current_joint_pos: ``(num_envs, num_joints)`` [m or rad], for the null space.
            current_joint_vel: ``(num_envs, num_joints)`` [m/s or rad/s], for the null space.
            nullspace_joint_pos_target: Joint positions wanted ``(num_envs, num_joints)``; None means zero.

        Raises:
            ValueError: if something is missing that the config asks for, or no joints are left for a null space.
        """
        inertia: torch.Tensor | None = None
        if self.cfg.inertial_dynamics_decoupling:
            inertia = self._inertia(jacobian_b, _given(mass_matrix, "mass_matrix", "inertial_dynamics_decoupling"))
        force = torch.zeros(self.num_envs, 6, 1, dtype=jacobian_b.dtype, device=jacobian_b.device)
        if self._pose_b is not None:
            acceleration = self._acceleration(
                self._pose_b,
                _given(current_ee_pose_b, "current_ee_pose_b", "motion control"),
                _given(current_ee_vel_b, "current_ee_vel_b", "motion control"),
            )
            motion = acceleration if inertia is None else inertia @ acceleration
            force = force + self._in_root_frame(self._motion_axes) @ motion
        if self.desired_ee_wrench_b is not None:
            wrench = self._wrench(self.desired_ee_wrench_b, current_ee_force_b)
            force = force + self._in_root_frame(self._force_axes) @ wrench
        efforts = (jacobian_b.mT @ force).squeeze(-1)
        if self.cfg.gravity_compensation:
            efforts = efforts + _given(gravity, "gravity", "gravity_compensation")
        if self.cfg.nullspace_control == "none":
            return efforts
        wanted = self._joint_acceleration(
            _given(current_joint_pos, "current_joint_pos", "nullspace_control"),
            _given(current_joint_vel, "current_joint_vel", "nullspace_control"),
            nullspace_joint_pos_target,
        )
        if mass_matrix is not None:
            wanted = mass_matrix @ wanted
        return efforts + (self._nullspace(jacobian_b, mass_matrix, inertia) @ wanted).squeeze(-1)

    # ---- targets

    def _set_pose(self, target: torch.Tensor, frame: torch.Tensor, now: torch.Tensor | None, relative: bool) -> None:
        if relative:
            now = _given(now, "current_ee_pose_b", "a target 'pose_rel'")
            pos, quat = subtract_frame_transforms(frame[:, :3], frame[:, 3:], now[:, :3], now[:, 3:])
            target = torch.cat(apply_delta_pose(pos, quat, target), dim=-1)
        self._pose_task = target.clone()
        pose = combine_frame_transforms(frame[:, :3], frame[:, 3:], target[:, :3], target[:, 3:])
        self._pose_b = torch.cat(pose, dim=-1)

    def _set_wrench(self, target: torch.Tensor, frame: torch.Tensor) -> None:
        self.desired_ee_wrench_task = target.clone()
        force, torque = ((self._turn @ part.unsqueeze(-1)).squeeze(-1) for part in (target[:, :3], target[:, 3:]))
        self.desired_ee_wrench_b = torch.cat((force, torque + torch.linalg.cross(frame[:, :3], force)), dim=-1)

    # ---- forces at the body, (num_envs, 6, 1)

    def _acceleration(self, wanted: torch.Tensor, pose: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
        """Acceleration of a spring and damper towards the target, which stands still."""
        error = torch.cat(compute_pose_error(pose[:, :3], pose[:, 3:], wanted[:, :3], wanted[:, 3:]), dim=-1)
        # Gains of free axes are zero: with decoupling their error would move the others.
        stiffness = self._motion_axes * self._stiffness
        damping = 2.0 * stiffness.sqrt() * self._damping_ratio
        spring = self._in_root_frame(stiffness) @ error.unsqueeze(-1)
        return spring - self._in_root_frame(damping) @ velocity.unsqueeze(-1)

    def _wrench(self, wanted: torch.Tensor, measured: torch.Tensor | None) -> torch.Tensor:
        """Wrench commanded, with feedback of the force where a gain is given."""
        if self.cfg.contact_wrench_stiffness_task is None:
            return wanted.unsqueeze(-1)
        force = _given(measured, "current_ee_force_b", "contact_wrench_stiffness_task")
        error = torch.cat((wanted[:, :3] - force, torch.zeros_like(force)), dim=-1)
        gain = self._in_root_frame(self._force_axes * self._six(self.cfg.contact_wrench_stiffness_task))
        return wanted.unsqueeze(-1) + gain @ error.unsqueeze(-1)

    def _inertia(self, jacobian: torch.Tensor, mass_matrix: torch.Tensor) -> torch.Tensor:
        """Inertia felt at the body, ``(J M^-1 J^T)^-1``, ``(num_envs, 6, 6)``."""
        mobility = jacobian @ torch.linalg.solve(mass_matrix, jacobian.mT)
        if not self.cfg.partial_inertial_dynamics_decoupling:
            return torch.linalg.inv(mobility)
        out = torch.zeros_like(mobility)
        out[:, :3, :3] = torch.linalg.inv(mobility[:, :3, :3])
        out[:, 3:, 3:] = torch.linalg.inv(mobility[:, 3:, 3:])
        return out

    # ---- null space

    def _joint_acceleration(self, pos: torch.Tensor, vel: torch.Tensor, wanted: torch.Tensor | None) -> torch.Tensor:
        """Accelerations of joints towards the positions wanted, ``(num_envs, num_joints, 1)``."""
        if wanted is None:
            wanted = torch.zeros_like(pos)
        if wanted.shape != pos.shape:
            raise ValueError(
                f"compute: nullspace_joint_pos_target is {tuple(wanted.shape)}, must be as the joint positions, "
                f"{tuple(pos.shape)}"
            )
        damping = 2.0 * self.cfg.nullspace_stiffness**0.5 * self.cfg.nullspace_damping_ratio
        return (self.cfg.nullspace_stiffness * (wanted - pos) - damping * vel).unsqueeze(-1)

    def _nullspace(
        self, jacobian: torch.Tensor, mass_matrix: torch.Tensor | None, inertia: torch.Tensor | None
    ) -> torch.Tensor:
        """Projector of efforts to those that do not move the body, ``(num_envs, num_joints, num_joints)``."""
        joints = jacobian.shape[2]
        if joints <= 6:
            raise ValueError(f"compute: nullspace_control needs more than 6 joints, the Jacobian has {joints}")
        if inertia is not None and mass_matrix is not None and not self.cfg.partial_inertial_dynamics_decoupling:
            # The inverse weighted by the inertia is the one whose efforts give the body no acceleration.
            inverse_transposed = inertia @ torch.linalg.solve(mass_matrix, jacobian.mT).mT
        else:
            inverse_transposed = torch.linalg.pinv(jacobian).mT
        unit = torch.eye(joints, dtype=jacobian.dtype, device=jacobian.device)
        return unit - jacobian.mT @ inverse_transposed

    # ---- frames

    def _six(self, value: float | Sequence[float]) -> torch.Tensor:
        """One number, or six, as ``(num_envs, 6)``."""
        return torch.as_tensor(value, dtype=torch.float32, device=self.device).expand(self.num_envs, 6)

    def _in_root_frame(self, diagonal: torch.Tensor) -> torch.Tensor:
        """Diagonal matrices of the task's frame, ``(num_envs, 6)``, in the root's frame, ``(num_envs, 6, 6)``."""
        out = torch.zeros(self.num_envs, 6, 6, dtype=self._turn.dtype, device=diagonal.device)
        for part in (slice(0, 3), slice(3, 6)):
            out[:, part, part] = (self._turn * diagonal[:, None, part].to(self._turn.dtype)) @ self._turn.mT
        return out


def _given(value: torch.Tensor | None, name: str, reason: str) -> torch.Tensor:
    """``value``, or an error that says who needs it."""
    if value is None:
        raise ValueError(f"{name} is missing, which {reason} needs")
    return value
