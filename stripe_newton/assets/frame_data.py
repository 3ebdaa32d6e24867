# SPDX-License-Identifier: Apache-2.0
"""Frame data: states of the two frames of a body, at its link's origin and at its centre of mass, by Isaac Lab's names.

``root_link_*`` and ``body_link_*`` are of the link's origin, ``root_com_*`` and ``body_com_*`` of the centre of mass.
The frame at the centre of mass has the axes of the link, as the inertia here is a full matrix in these axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from stripe_newton.math import quat_apply, quat_apply_inverse

__all__ = ["FrameData"]


class FrameData:
    """Properties of :class:`RootData` that follow from poses of links and velocities of centres of mass.

    Frames: ``_w`` world, ``_b`` root body, ``body_com_*_b`` the body's own link. A pose is position [m] and quaternion
    (x, y, z, w), a velocity linear [m/s] and angular [rad/s], a state both: 7, 6 and 13 numbers.
    """

    if TYPE_CHECKING:  # what RootData has

        @property
        def root_pose_w(self) -> torch.Tensor: ...
        @property
        def root_vel_w(self) -> torch.Tensor: ...
        @property
        def root_com_offset_b(self) -> torch.Tensor: ...
        @property
        def body_pose_w(self) -> torch.Tensor: ...
        @property
        def body_vel_w(self) -> torch.Tensor: ...
        @property
        def body_com_pos_b(self) -> torch.Tensor: ...
        @property
        def body_acc_w(self) -> torch.Tensor: ...

    # -- the root's link

    @property
    def root_link_pose_w(self) -> torch.Tensor:
        """The same as ``root_pose_w`` (view), shape ``(num_envs, 7)``."""
        return self.root_pose_w

    @property
    def root_link_pos_w(self) -> torch.Tensor:
        """The same as ``root_pos_w`` [m] (view), shape ``(num_envs, 3)``."""
        return self.root_pose_w[:, :3]

    @property
    def root_link_quat_w(self) -> torch.Tensor:
        """The same as ``root_quat_w`` (view), shape ``(num_envs, 4)``."""
        return self.root_pose_w[:, 3:7]

    @property
    def root_link_lin_vel_w(self) -> torch.Tensor:
        """Linear velocity of the root link's origin [m/s], shape ``(num_envs, 3)``."""
        return _velocity_at_link(self.root_pose_w, self.root_vel_w, self.root_com_offset_b)

    @property
    def root_link_ang_vel_w(self) -> torch.Tensor:
        """The same as ``root_ang_vel_w`` [rad/s] (view), shape ``(num_envs, 3)``."""
        return self.root_vel_w[:, 3:6]

    @property
    def root_link_vel_w(self) -> torch.Tensor:
        """Velocity of the root link's origin, shape ``(num_envs, 6)``."""
        return torch.cat((self.root_link_lin_vel_w, self.root_link_ang_vel_w), dim=-1)

    @property
    def root_link_state_w(self) -> torch.Tensor:
        """State of the root link's origin, shape ``(num_envs, 13)``."""
        return torch.cat((self.root_pose_w, self.root_link_vel_w), dim=-1)

    @property
    def root_link_lin_vel_b(self) -> torch.Tensor:
        """:attr:`root_link_lin_vel_w` in the root's frame [m/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_link_quat_w, self.root_link_lin_vel_w)

    @property
    def root_link_ang_vel_b(self) -> torch.Tensor:
        """:attr:`root_link_ang_vel_w` in the root's frame [rad/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_link_quat_w, self.root_link_ang_vel_w)

    # -- the root's centre of mass

    @property
    def root_com_pos_w(self) -> torch.Tensor:
        """Position of the root's centre of mass [m], shape ``(num_envs, 3)``."""
        return self.root_link_pos_w + quat_apply(self.root_link_quat_w, self.root_com_offset_b)

    @property
    def root_com_quat_w(self) -> torch.Tensor:
        """The same as ``root_quat_w`` (view), shape ``(num_envs, 4)``."""
        return self.root_link_quat_w

    @property
    def root_com_pose_w(self) -> torch.Tensor:
        """Pose of the root's centre of mass, shape ``(num_envs, 7)``."""
        return torch.cat((self.root_com_pos_w, self.root_com_quat_w), dim=-1)

    @property
    def root_com_vel_w(self) -> torch.Tensor:
        """The same as ``root_vel_w`` (view), shape ``(num_envs, 6)``."""
        return self.root_vel_w

    @property
    def root_com_lin_vel_w(self) -> torch.Tensor:
        """The same as ``root_lin_vel_w`` [m/s] (view), shape ``(num_envs, 3)``."""
        return self.root_vel_w[:, :3]

    @property
    def root_com_ang_vel_w(self) -> torch.Tensor:
        """The same as ``root_ang_vel_w`` [rad/s] (view), shape ``(num_envs, 3)``."""
        return self.root_vel_w[:, 3:6]

    @property
    def root_com_state_w(self) -> torch.Tensor:
        """State of the root's centre of mass, shape ``(num_envs, 13)``."""
        return torch.cat((self.root_com_pose_w, self.root_vel_w), dim=-1)

    @property
    def root_com_lin_vel_b(self) -> torch.Tensor:
        """:attr:`root_com_lin_vel_w` in the root's frame [m/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_link_quat_w, self.root_com_lin_vel_w)

    @property
    def root_com_ang_vel_b(self) -> torch.Tensor:
        """:attr:`root_com_ang_vel_w` in the root's frame [rad/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_link_quat_w, self.root_com_ang_vel_w)

    # -- links of all bodies

    @property
    def body_link_pose_w(self) -> torch.Tensor:
        """The same as ``body_pose_w`` (view), shape ``(num_envs, num_bodies, 7)``."""
        return self.body_pose_w

    @property
    def body_link_pos_w(self) -> torch.Tensor:
        """The same as ``body_pos_w`` [m] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_pose_w[..., :3]

    @property
    def body_link_quat_w(self) -> torch.Tensor:
        """The same as ``body_quat_w`` (view), shape ``(num_envs, num_bodies, 4)``."""
        return self.body_pose_w[..., 3:7]

    @property
    def body_link_lin_vel_w(self) -> torch.Tensor:
        """Linear velocities of the link origins [m/s], shape ``(num_envs, num_bodies, 3)``."""
        return _velocity_at_link(self.body_pose_w, self.body_vel_w, self.body_com_pos_b)

    @property
    def body_link_ang_vel_w(self) -> torch.Tensor:
        """The same as ``body_ang_vel_w`` [rad/s] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_vel_w[..., 3:6]

    @property
    def body_link_vel_w(self) -> torch.Tensor:
        """Velocities of the link origins, shape ``(num_envs, num_bodies, 6)``."""
        return torch.cat((self.body_link_lin_vel_w, self.body_link_ang_vel_w), dim=-1)

    @property
    def body_link_state_w(self) -> torch.Tensor:
        """States of the link origins, shape ``(num_envs, num_bodies, 13)``."""
        return torch.cat((self.body_pose_w, self.body_link_vel_w), dim=-1)

    # -- centres of mass of all bodies

    @property
    def body_com_pos_w(self) -> torch.Tensor:
        """Positions of the centres of mass [m], shape ``(num_envs, num_bodies, 3)``."""
        return self.body_link_pos_w + quat_apply(self.body_link_quat_w, self.body_com_pos_b)

    @property
    def body_com_quat_w(self) -> torch.Tensor:
        """The same as ``body_quat_w`` (view), shape ``(num_envs, num_bodies, 4)``."""
        return self.body_link_quat_w

    @property
    def body_com_pose_w(self) -> torch.Tensor:
        """Poses of the centres of mass, shape ``(num_envs, num_bodies, 7)``."""
        return torch.cat((self.body_com_pos_w, self.body_com_quat_w), dim=-1)

    @property
    def body_com_vel_w(self) -> torch.Tensor:
        """The same as ``body_vel_w`` (view), shape ``(num_envs, num_bodies, 6)``."""
        return self.body_vel_w

    @property
    def body_com_lin_vel_w(self) -> torch.Tensor:
        """The same as ``body_lin_vel_w`` [m/s] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_vel_w[..., :3]

    @property
    def body_com_ang_vel_w(self) -> torch.Tensor:
        """The same as ``body_ang_vel_w`` [rad/s] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_vel_w[..., 3:6]

    @property
    def body_com_state_w(self) -> torch.Tensor:
        """States of the centres of mass, shape ``(num_envs, num_bodies, 13)``."""
        return torch.cat((self.body_com_pose_w, self.body_vel_w), dim=-1)

    @property
    def body_lin_acc_w(self) -> torch.Tensor:
        """Linear part of :attr:`body_acc_w` [m/s^2] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_acc_w[..., :3]

    @property
    def body_ang_acc_w(self) -> torch.Tensor:
        """Angular part of :attr:`body_acc_w` [rad/s^2] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_acc_w[..., 3:6]

    @property
    def body_com_acc_w(self) -> torch.Tensor:
        """The same as ``body_acc_w`` (view), shape ``(num_envs, num_bodies, 6)``."""
        return self.body_acc_w

    @property
    def body_com_lin_acc_w(self) -> torch.Tensor:
        """The same as ``body_lin_acc_w`` [m/s^2] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_acc_w[..., :3]

    @property
    def body_com_ang_acc_w(self) -> torch.Tensor:
        """The same as ``body_ang_acc_w`` [rad/s^2] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self.body_acc_w[..., 3:6]

    @property
    def body_com_quat_b(self) -> torch.Tensor:
        """Orientations at the centres of mass in the link frames: the identity, ``(num_envs, num_bodies, 4)``."""
        quat = torch.zeros_like(self.body_link_quat_w)
        quat[..., 3] = 1.0
        return quat

    @property
    def body_com_pose_b(self) -> torch.Tensor:
        """Poses of the centres of mass in the link frames, shape ``(num_envs, num_bodies, 7)``."""
        return torch.cat((self.body_com_pos_b, self.body_com_quat_b), dim=-1)


def _velocity_at_link(pose: torch.Tensor, velocity: torch.Tensor, com: torch.Tensor) -> torch.Tensor:
    """Linear velocity of the link's origin [m/s] from that of the centre of mass at ``com`` in the link, (..., 3)."""
    arm = quat_apply(pose[..., 3:7], com)
    return velocity[..., :3] - torch.linalg.cross(velocity[..., 3:6], arm)
