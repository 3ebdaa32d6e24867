# SPDX-License-Identifier: Apache-2.0
"""Root writer: sets pose and velocity of an asset's root, of its link or of its centre of mass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from stripe_newton.math import quat_apply

from .layout import Layout
from .root_data import RootData

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["EnvIds", "RootWriter"]

EnvIds = Sequence[int] | torch.Tensor | slice | None
"""Environments by index; ``None`` means all."""


class RootWriter:
    """The methods of an asset that set the state of its root.

    No ``write_*`` method calls another: a subclass may convert what each of them takes.
    """

    layout: Layout
    """Its rows in the arrays of the model, once it is prepared."""
    _sim: Simulation
    _data: RootData
    _ALL_INDICES: torch.Tensor

    @property
    def device(self) -> str:
        """Device of the simulation."""
        return self._sim.device

    def env_indices(self, env_ids: EnvIds) -> torch.Tensor:
        """``env_ids`` as an int64 tensor on the device, shape ``(n,)``."""
        if env_ids is None:
            return self._ALL_INDICES
        if isinstance(env_ids, slice):
            return self._ALL_INDICES[env_ids]
        ids = torch.as_tensor(env_ids, device=self.device)
        return ids.nonzero().squeeze(-1) if ids.dtype == torch.bool else ids.long()

    def write_native_root_state(
        self, root_pose: torch.Tensor, root_velocity: torch.Tensor, env_ids: EnvIds = None
    ) -> None:
        """Set pose and velocity of the root, also where a subclass takes another form in its ``write_*`` methods.

        Args:
            root_pose: Of the link, world frame: position [m] and quaternion (x, y, z, w), shape ``(n, 7)``.
            root_velocity: Of the centre of mass, world frame: linear [m/s] and angular [rad/s], shape ``(n, 6)``.
            env_ids: Environments, default all.
        """
        ids = self.env_indices(env_ids)
        self._set_pose(root_pose, ids)
        self._set_velocity(root_velocity, ids)

    # -- the pose of the link and the velocity of the centre of mass, as the simulation keeps them

    def write_root_pose_to_sim(self, root_pose: torch.Tensor, env_ids: EnvIds = None) -> None:
        """Set the pose of the root link in the world frame.

        Args:
            root_pose: Position [m] and quaternion (x, y, z, w), shape ``(n, 7)``.
            env_ids: Environments, default all.
        """
        self._set_pose(root_pose, self.env_indices(env_ids))

    def write_root_velocity_to_sim(self, root_velocity: torch.Tensor, env_ids: EnvIds = None) -> None:
        """Set the velocity of the root's centre of mass in the world frame.

        Args:
            root_velocity: Linear [m/s] and angular [rad/s], shape ``(n, 6)``; ignored for a fixed base.
            env_ids: Environments, default all.
        """
        self._set_velocity(root_velocity, self.env_indices(env_ids))

    def write_root_state_to_sim(self, root_state: torch.Tensor, env_ids: EnvIds = None) -> None:
        """Set the pose of the root link and the velocity of the root's centre of mass, world frame.

        Args:
            root_state: Shape ``(n, 13)``.
            env_ids: Environments, default all.
        """
        self.write_native_root_state(root_state[:, :7], root_state[:, 7:], env_ids)

    # -- the link

    def write_root_link_pose_to_sim(self, root_pose: torch.Tensor, env_ids: EnvIds = None) -> None:
        """The same as :meth:`write_root_pose_to_sim`."""
        self._set_pose(root_pose, self.env_indices(env_ids))

    def write_root_link_velocity_to_sim(self, root_velocity: torch.Tensor, env_ids: EnvIds = None) -> None:
        """Set the velocity of the root's link origin in the world frame, after its pose.

        Args:
            root_velocity: Linear [m/s] and angular [rad/s], shape ``(n, 6)``.
            env_ids: Environments, default all.
        """
        self._set_link_velocity(root_velocity, self.env_indices(env_ids))

    def write_root_link_state_to_sim(self, root_state: torch.Tensor, env_ids: EnvIds = None) -> None:
        """Set pose and velocity of the root link, world frame.

        Args:
            root_state: Shape ``(n, 13)``.
            env_ids: Environments, default all.
        """
        ids = self.env_indices(env_ids)
        self._set_pose(root_state[:, :7], ids)
        self._set_link_velocity(root_state[:, 7:], ids)

    # -- the centre of mass

    def write_root_com_pose_to_sim(self, root_pose: torch.Tensor, env_ids: EnvIds = None) -> None:
        """Set the pose of the root's centre of mass in the world frame; its axes are those of the link.

        Args:
            root_pose: Position [m] and quaternion (x, y, z, w), shape ``(n, 7)``.
            env_ids: Environments, default all.
        """
        self._set_com_pose(root_pose, self.env_indices(env_ids))

    def write_root_com_velocity_to_sim(self, root_velocity: torch.Tensor, env_ids: EnvIds = None) -> None:
        """The same as :meth:`write_root_velocity_to_sim`."""
        self._set_velocity(root_velocity, self.env_indices(env_ids))

    def write_root_com_state_to_sim(self, root_state: torch.Tensor, env_ids: EnvIds = None) -> None:
        """Set pose and velocity of the root's centre of mass, world frame.

        Args:
            root_state: Shape ``(n, 13)``.
            env_ids: Environments, default all.
        """
        ids = self.env_indices(env_ids)
        self._set_com_pose(root_state[:, :7], ids)
        self._set_velocity(root_state[:, 7:], ids)

    def _set_pose(self, pose: torch.Tensor, ids: torch.Tensor) -> None:
        self.layout.write_root_pose(self._sim, pose, ids)

    def _set_velocity(self, velocity: torch.Tensor, ids: torch.Tensor) -> None:
        self.layout.write_root_velocity(self._sim, velocity, ids)

    def _set_link_velocity(self, velocity: torch.Tensor, ids: torch.Tensor) -> None:
        offset = quat_apply(self._data.root_quat_w[ids], self._data.root_com_offset_b[ids])
        linear = velocity[:, :3] + torch.linalg.cross(velocity[:, 3:], offset)
        self._set_velocity(torch.cat((linear, velocity[:, 3:]), dim=-1), ids)

    def _set_com_pose(self, pose: torch.Tensor, ids: torch.Tensor) -> None:
        origin = pose[:, :3] - quat_apply(pose[:, 3:], self._data.root_com_offset_b[ids])
        self._set_pose(torch.cat((origin, pose[:, 3:]), dim=-1), ids)
