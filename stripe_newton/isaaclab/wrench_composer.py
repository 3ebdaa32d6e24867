# SPDX-License-Identifier: Apache-2.0
"""Wrench composers of the Isaac Lab dialect: wrenches that act on the bodies of an asset, always or in one step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from stripe_newton.math import quat_apply_inverse

if TYPE_CHECKING:
    from stripe_newton.assets import BoundAsset
    from stripe_newton.assets.root_writer import EnvIds

__all__ = ["AssetWrenches", "WrenchComposer"]

BodyIds = Sequence[int] | torch.Tensor | slice | None
Values = torch.Tensor | None


class WrenchComposer:
    """Forces and torques on the bodies of an asset in their frames, set or added up.

    The force acts at the centre of mass. ``positions`` are relative to the origins of the bodies, and add a torque.
    """

    def __init__(self, asset: BoundAsset):
        self._asset = asset
        shape, device = (asset.num_instances, asset.num_bodies, 3), asset.device
        self.composed_force = torch.zeros(shape, device=device)
        """Forces in the bodies' frames [N], shape ``(num_envs, num_bodies, 3)``."""
        self.composed_torque = torch.zeros(shape, device=device)
        """Torques in the bodies' frames [N m], same shape."""
        self.active = False
        """Whether anything was set or added since the last full reset."""
        self.changed = False
        """Whether something changed since the wrenches were handed to the simulation."""

    @property
    def composed_force_as_torch(self) -> torch.Tensor:
        """:attr:`composed_force`."""
        return self.composed_force

    @property
    def composed_torque_as_torch(self) -> torch.Tensor:
        """:attr:`composed_torque`."""
        return self.composed_torque

    def set_forces_and_torques(
        self,
        forces: Values = None,
        torques: Values = None,
        positions: Values = None,
        body_ids: BodyIds = None,
        env_ids: EnvIds = None,
        is_global: bool = False,
    ) -> None:
        """Set the wrench of some bodies.

        Args:
            forces: Forces [N], shape ``(n, bodies, 3)``; None leaves those that are set.
            torques: Torques [N m], same shape; None leaves those that are set, unless there are positions.
            positions: Points of attack [m], same shape: relative to the origins of the bodies in their frames, or in
                the world.
            body_ids: Bodies, default all.
            env_ids: Environments, default all.
            is_global: Whether all three are in the world frame, as the bodies stand now.
        """
        rows, force, torque = self._local(forces, torques, positions, body_ids, env_ids, is_global)
        if force is not None:
            self.composed_force[rows] = force
        if torque is not None:
            self.composed_torque[rows] = torque

    def add_forces_and_torques(
        self,
        forces: Values = None,
        torques: Values = None,
        positions: Values = None,
        body_ids: BodyIds = None,
        env_ids: EnvIds = None,
        is_global: bool = False,
    ) -> None:
        """Add to the wrench of some bodies; arguments as of :meth:`set_forces_and_torques`."""
        rows, force, torque = self._local(forces, torques, positions, body_ids, env_ids, is_global)
        if force is not None:
            self.composed_force[rows] += force
        if torque is not None:
            self.composed_torque[rows] += torque

    def reset(self, env_ids: EnvIds = None) -> None:
        """Remove the wrenches of some environments, default all."""
        if not self.active:
            return
        ids = self._asset.env_indices(env_ids)
        self.composed_force[ids] = 0.0
        self.composed_torque[ids] = 0.0
        self.changed = True
        self.active = env_ids is not None

    def _local(
        self, forces: Values, torques: Values, positions: Values, body_ids: BodyIds, env_ids: EnvIds, is_global: bool
    ) -> tuple[tuple[torch.Tensor, torch.Tensor], Values, Values]:
        """Rows of the buffers, and forces and torques in the frames of the bodies."""
        asset = self._asset
        self.active = self.changed = True
        bodies = torch.arange(asset.num_bodies, device=asset.device)
        if body_ids is not None:
            bodies = bodies[body_ids if isinstance(body_ids, slice) else torch.as_tensor(body_ids, device=asset.device)]
        rows = asset.env_indices(env_ids).unsqueeze(1), bodies.unsqueeze(0)
        force = None if forces is None else forces.to(self.composed_force)
        torque = None if torques is None else torques.to(self.composed_force)
        if is_global:
            pose = asset.native_data.body_pose_w[rows]
            if force is not None:
                force = quat_apply_inverse(pose[..., 3:], force.expand(*pose.shape[:2], 3))
            if torque is not None:
                torque = quat_apply_inverse(pose[..., 3:], torque.expand(*pose.shape[:2], 3))
            if positions is not None:
                positions = quat_apply_inverse(pose[..., 3:], positions - pose[..., :3])
        if positions is not None and force is not None:
            lever = torch.linalg.cross(positions.to(force), force)
            torque = lever if torque is None else torque + lever
        return rows, force, torque


class AssetWrenches:
    """The two composers of an asset, and what they hand to the simulation before a step."""

    def __init__(self, asset: BoundAsset):
        self._asset = asset
        self.permanent, self.instantaneous = WrenchComposer(asset), WrenchComposer(asset)

    def write(self) -> None:
        """Hand the sum to the simulation if it changed; what is instantaneous is gone with the next call."""
        always, once = self.permanent, self.instantaneous
        if not (always.changed or once.changed):
            return
        self._asset.write_native_wrench(
            always.composed_force + once.composed_force, always.composed_torque + once.composed_torque
        )
        always.changed = False
        once.changed = once.active
        once.composed_force.zero_()
        once.composed_torque.zero_()
        once.active = False

    def reset(self, env_ids: EnvIds) -> None:
        """Remove the wrenches of some environments."""
        self.permanent.reset(env_ids)
        self.instantaneous.reset(env_ids)
