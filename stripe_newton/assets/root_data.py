# SPDX-License-Identifier: Apache-2.0
"""State of the root and the bodies of an asset, in world and body frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
import warp as wp

from stripe_newton.math import quat_apply, quat_apply_inverse

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

    from .layout import Layout

__all__ = ["RootData", "WarpView"]


class WarpView:
    """The zero-copy buffers of a data object as Warp arrays, by the same names."""

    _TYPES = {"quat_w": wp.quat, "pose_w": wp.transform, "pos_w": wp.vec3, "vel_w": wp.vec3}

    def __init__(self, data: Any):
        self._data = data

    def __getattr__(self, name: str) -> wp.array:
        tensor = getattr(self._data, name)
        if not isinstance(tensor, torch.Tensor) or tensor.untyped_storage().data_ptr() not in self._data._storages:
            raise AttributeError(
                f"'{name}' is computed when asked for, it has no buffer to share; compute it in a kernel"
            )
        kind = next((t for suffix, t in self._TYPES.items() if name.endswith(suffix)), None)
        return wp.from_torch(tensor, dtype=kind or wp.dtype_from_torch(tensor.dtype))


class RootData:
    """Tensors lead with the environment: ``(num_envs, ...)``. Those marked *view* share memory with the simulation:
    writing them writes its state. The others are computed from the state when asked for, and so never go stale.

    Frames: ``_w`` world, ``_b`` root body. Quaternions are (x, y, z, w). The linear velocity of ``root_lin_vel_*`` and
    ``body_lin_vel_w`` is that of the centre of mass, of ``*_link_lin_vel_*`` that of the link's origin.
    """

    default_root_state: torch.Tensor
    """Root state at the start of an episode: position in the environment's frame [m], quaternion, linear [m/s] and
    angular velocity [rad/s], shape ``(num_envs, 13)``."""

    def __init__(self, sim: Simulation, layout: Layout):
        self._sim, self._layout = sim, layout
        self.joint_names = list(layout.joint_names)
        """Names, one a degree of freedom."""
        self.body_names = list(layout.body_names)
        """Names of the bodies, root first."""
        rows = layout.body_slice
        self._poses = sim.per_env(sim.state.body_q)[:, rows]
        self._velocities = sim.per_env(sim.state.body_qd)[:, rows]
        self._body_com = sim.per_env(sim.model.body_com)[:, rows]
        self._body_mass = sim.per_env(sim.model.body_mass)[:, rows]
        self._body_inertia = sim.per_env(sim.model.body_inertia)[:, rows]
        if layout.floating:
            coord, dof = layout.root_coord, layout.root_dof
            self._root_pose = sim.per_env(sim.state.joint_q)[:, coord : coord + 7]
            self._root_vel = sim.per_env(sim.state.joint_qd)[:, dof : dof + 6]
        else:
            self._root_pose, self._root_vel = self._poses[:, 0], self._velocities[:, 0]
        gravity = wp.to_torch(sim.model.gravity)[0]
        down = gravity / gravity.norm() if gravity.norm() > 0 else torch.tensor([0.0, 0.0, -1.0], device=sim.device)
        self.GRAVITY_VEC_W = down.repeat(sim.num_envs, 1)
        """Direction of gravity in the world frame, shape ``(num_envs, 3)``."""
        self.FORWARD_VEC_B = torch.tensor([1.0, 0.0, 0.0], device=sim.device).repeat(sim.num_envs, 1)
        """The x axis, shape ``(num_envs, 3)``."""
        state, model, control = sim.state, sim.model, sim.control
        shared = (state.joint_q, state.joint_qd, state.body_q, state.body_qd, model.body_com, model.body_mass,
                  control.joint_target_q, control.joint_target_qd, control.joint_act, model.joint_target_ke,
                  model.joint_target_kd, model.joint_armature, model.joint_friction, model.joint_effort_limit,
                  model.joint_velocity_limit)  # fmt: skip
        self._storages = {wp.to_torch(a).untyped_storage().data_ptr() for a in shared if a is not None and a.size}
        self.warp = WarpView(self)
        """The views as Warp arrays: ``data.warp.joint_pos`` and so on."""

    @property
    def _body_q(self) -> torch.Tensor:
        self._sim.flush()
        return self._poses

    @property
    def _body_qd(self) -> torch.Tensor:
        self._sim.flush()
        return self._velocities

    # -- root

    @property
    def default_root_pose(self) -> torch.Tensor:
        """Pose part of :attr:`default_root_state` (view), shape ``(num_envs, 7)``."""
        return self.default_root_state[:, :7]

    @property
    def root_pose_w(self) -> torch.Tensor:
        """Pose of the root link (view): position [m] and quaternion, shape ``(num_envs, 7)``."""
        return self._root_pose

    @property
    def root_pos_w(self) -> torch.Tensor:
        """Position of the root link [m] (view), shape ``(num_envs, 3)``."""
        return self._root_pose[:, :3]

    @property
    def root_quat_w(self) -> torch.Tensor:
        """Orientation of the root link (view), shape ``(num_envs, 4)``."""
        return self._root_pose[:, 3:7]

    @property
    def root_vel_w(self) -> torch.Tensor:
        """Linear velocity of the root's centre of mass [m/s] and angular velocity [rad/s] (view), ``(num_envs, 6)``."""
        return self._root_vel

    @property
    def root_lin_vel_w(self) -> torch.Tensor:
        """Linear velocity of the root's centre of mass [m/s] (view), shape ``(num_envs, 3)``."""
        return self._root_vel[:, :3]

    @property
    def root_ang_vel_w(self) -> torch.Tensor:
        """Angular velocity of the root [rad/s] (view), shape ``(num_envs, 3)``."""
        return self._root_vel[:, 3:6]

    @property
    def root_state_w(self) -> torch.Tensor:
        """:attr:`root_pose_w` and :attr:`root_vel_w`, shape ``(num_envs, 13)``."""
        return torch.cat((self._root_pose, self._root_vel), dim=-1)

    @property
    def root_com_offset_b(self) -> torch.Tensor:
        """Centre of mass of the root in its link frame [m], shape ``(num_envs, 3)``."""
        return self._body_com[:, 0]

    @property
    def root_com_pos_w(self) -> torch.Tensor:
        """Position of the root's centre of mass [m], shape ``(num_envs, 3)``."""
        return self.root_pos_w + quat_apply(self.root_quat_w, self.root_com_offset_b)

    @property
    def root_link_lin_vel_w(self) -> torch.Tensor:
        """Linear velocity of the root link's origin [m/s], shape ``(num_envs, 3)``."""
        offset = quat_apply(self.root_quat_w, self.root_com_offset_b)
        return self.root_lin_vel_w - torch.linalg.cross(self.root_ang_vel_w, offset)

    @property
    def root_lin_vel_b(self) -> torch.Tensor:
        """:attr:`root_lin_vel_w` in the root's frame [m/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_quat_w, self.root_lin_vel_w)

    @property
    def root_link_lin_vel_b(self) -> torch.Tensor:
        """:attr:`root_link_lin_vel_w` in the root's frame [m/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_quat_w, self.root_link_lin_vel_w)

    @property
    def root_ang_vel_b(self) -> torch.Tensor:
        """:attr:`root_ang_vel_w` in the root's frame [rad/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_quat_w, self.root_ang_vel_w)

    @property
    def projected_gravity_b(self) -> torch.Tensor:
        """Direction of gravity in the root's frame, shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_quat_w, self.GRAVITY_VEC_W)

    @property
    def heading_w(self) -> torch.Tensor:
        """Angle of the root's x axis in the ground plane [rad], shape ``(num_envs,)``."""
        forward = quat_apply(self.root_quat_w, self.FORWARD_VEC_B)
        return torch.atan2(forward[:, 1], forward[:, 0])

    # -- bodies

    @property
    def body_pose_w(self) -> torch.Tensor:
        """Poses of the link frames (view): position [m] and quaternion, shape ``(num_envs, num_bodies, 7)``."""
        return self._body_q

    @property
    def body_pos_w(self) -> torch.Tensor:
        """Positions of the link frames [m] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self._body_q[..., :3]

    @property
    def body_quat_w(self) -> torch.Tensor:
        """Orientations of the link frames (view), shape ``(num_envs, num_bodies, 4)``."""
        return self._body_q[..., 3:7]

    @property
    def body_vel_w(self) -> torch.Tensor:
        """Velocities of the centres of mass [m/s] and angular velocities [rad/s] (view), ``(num_envs, bodies, 6)``."""
        return self._body_qd

    @property
    def body_lin_vel_w(self) -> torch.Tensor:
        """Linear velocities of the centres of mass [m/s] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self._body_qd[..., :3]

    @property
    def body_ang_vel_w(self) -> torch.Tensor:
        """Angular velocities [rad/s] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self._body_qd[..., 3:6]

    @property
    def body_state_w(self) -> torch.Tensor:
        """:attr:`body_pose_w` and :attr:`body_vel_w`, shape ``(num_envs, num_bodies, 13)``."""
        return torch.cat((self._body_q, self._body_qd), dim=-1)

    @property
    def body_link_lin_vel_w(self) -> torch.Tensor:
        """Linear velocities of the link origins [m/s], shape ``(num_envs, num_bodies, 3)``."""
        offset = quat_apply(self.body_quat_w, self._body_com)
        return self.body_lin_vel_w - torch.linalg.cross(self.body_ang_vel_w, offset)

    @property
    def body_com_pos_w(self) -> torch.Tensor:
        """Positions of the centres of mass [m], shape ``(num_envs, num_bodies, 3)``."""
        return self.body_pos_w + quat_apply(self.body_quat_w, self._body_com)

    @property
    def body_com_pos_b(self) -> torch.Tensor:
        """Centres of mass in the link frames [m] (view), shape ``(num_envs, num_bodies, 3)``."""
        return self._body_com

    @property
    def body_mass(self) -> torch.Tensor:
        """Masses [kg] (view), shape ``(num_envs, num_bodies)``."""
        return self._body_mass

    @property
    def default_mass(self) -> torch.Tensor:
        """Masses as built [kg], shape ``(num_envs, num_bodies)``."""
        return self._default_mass

    @property
    def body_inertia(self) -> torch.Tensor:
        """Inertia about the centres of mass, link frames [kg m^2] (view), shape ``(num_envs, num_bodies, 3, 3)``."""
        return self._body_inertia

    @property
    def struct(self) -> Any:
        """The state as the struct that Warp terms read, ``stripe_kernels.data.ArticulationData``; same memory."""
        return self._made_struct()[0]

    @property
    def unavailable(self) -> dict[str, str]:
        """Fields of :attr:`struct` that may not be read, and why."""
        return self._made_struct()[1]

    def _made_struct(self) -> tuple[Any, dict[str, str]]:
        from .structs import make_struct

        wrench = self._sim.external_wrench is not None
        if self._struct is None or self._struct_has_wrench != wrench:
            self._struct = make_struct(self._sim, self._layout, self, self._soft)
            self._struct_has_wrench = wrench
        return self._struct

    _struct: tuple[Any, dict[str, str]] | None = None
    _struct_has_wrench = False
    _soft = 1.0

    def set_defaults(self, cfg: object, origins: torch.Tensor) -> None:
        """Fill the defaults from the state as built and the config's initial velocities."""
        self._default_mass = self._body_mass.clone()
        self.default_root_state = self.root_state_w.clone()
        self.default_root_state[:, :3] -= origins
        for columns, name in ((slice(7, 10), "lin_vel"), (slice(10, 13), "ang_vel")):
            self.default_root_state[:, columns] = torch.tensor(getattr(cfg, name), device=origins.device)
