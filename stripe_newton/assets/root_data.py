# SPDX-License-Identifier: Apache-2.0
"""Root data: state of the root and the bodies of an asset, in world and body frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
import warp as wp

import stripe_kernels.data as kernels
from stripe_newton.math import quat_apply, quat_apply_inverse

from .frame_data import FrameData

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

    from .layout import Layout

__all__ = ["RootData", "WarpView"]

_JOINT_FIELDS = (
    "joint_pos", "joint_vel", "previous_joint_vel", "default_joint_pos", "default_joint_vel", "joint_pos_target",
    "joint_vel_target", "joint_effort_target", "joint_drive_effort", "joint_other_effort", "joint_stiffness",
    "joint_damping", "joint_pos_lower", "joint_pos_upper", "joint_vel_limit", "joint_effort_limit",
)  # fmt: skip
"""Fields of the struct about joints, all float32."""


class WarpView:
    """The zero-copy buffers of a data object as Warp arrays, by the same names."""

    _TYPES = {"quat_w": wp.quat, "pose_w": wp.transform, "pos_w": wp.vec3, "vel_w": wp.vec3}

    def __init__(self, data: RootData):
        self._data = data

    def __getattr__(self, name: str) -> wp.array:
        tensor = getattr(self._data, name)
        if not isinstance(tensor, torch.Tensor) or tensor.untyped_storage().data_ptr() not in self._data._storages:
            raise AttributeError(
                f"'{name}' is computed when asked for, it has no buffer to share; compute it in a kernel"
            )
        kind = next((t for suffix, t in self._TYPES.items() if name.endswith(suffix)), None)
        return wp.from_torch(tensor, dtype=kind or wp.dtype_from_torch(tensor.dtype))


class RootData(FrameData):
    """State of an asset as tensors that lead with the environment: ``(num_envs, ...)``.

    Those marked *view* share memory with the simulation: writing them writes its state. The others are computed from
    the state when asked for, and so never go stale.

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
        if layout.floating:  # the coordinates are the state: bodies are computed from them
            coord, dof = layout.root_coord, layout.root_dof
            self._root_pose = sim.per_env(sim.state.joint_q)[:, coord : coord + 7]
            self._root_vel = sim.per_env(sim.state.joint_qd)[:, dof : dof + 6]
        else:  # a fixed root has no coordinates; its body has the pose
            self._root_pose, self._root_vel = self._poses[:, 0], self._velocities[:, 0]
        # The direction as built: events that change gravity leave what projected_gravity refers to.
        gravity = wp.to_torch(sim.model.gravity)[0]
        down = gravity / gravity.norm() if gravity.norm() > 0 else torch.tensor([0.0, 0.0, -1.0], device=sim.device)
        self.GRAVITY_VEC_W = down.repeat(sim.num_envs, 1)
        """Direction of gravity in the world frame, shape ``(num_envs, 3)``."""
        self.FORWARD_VEC_B = torch.tensor([1.0, 0.0, 0.0], device=sim.device).repeat(sim.num_envs, 1)
        """The x axis, shape ``(num_envs, 3)``."""
        state, model, control = sim.state, sim.model, sim.control
        # WarpView tells views from computed tensors by the memory they lie in.
        shared = (state.joint_q, state.joint_qd, state.body_q, state.body_qd, model.body_com, model.body_mass,
                  control.joint_target_q, control.joint_target_qd, control.joint_act, model.joint_target_ke,
                  model.joint_target_kd, model.joint_armature, model.joint_friction, model.joint_effort_limit,
                  model.joint_velocity_limit)  # fmt: skip
        self._storages = {wp.to_torch(a).untyped_storage().data_ptr() for a in shared if a is not None and a.size}
        self.warp = WarpView(self)
        """The views as Warp arrays: ``data.warp.joint_pos`` and so on."""

    @property
    def _body_q(self) -> torch.Tensor:
        self._sim.flush()  # bodies of a new episode may not follow its joints yet
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
    def default_root_vel(self) -> torch.Tensor:
        """Velocity part of :attr:`default_root_state` (view), shape ``(num_envs, 6)``."""
        return self.default_root_state[:, 7:]

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
    def root_lin_vel_b(self) -> torch.Tensor:
        """:attr:`root_lin_vel_w` in the root's frame [m/s], shape ``(num_envs, 3)``."""
        return quat_apply_inverse(self.root_quat_w, self.root_lin_vel_w)

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
    def body_acc_w(self) -> torch.Tensor:
        """Accelerations of the centres of mass [m/s^2] and angular ones [rad/s^2] (view), ``(num_envs, bodies, 6)``.

        Raises:
            RuntimeError: the solver does not report them.
        """
        reported = self._sim.reported("body_qdd")
        if reported is None:
            raise RuntimeError("accelerations of bodies are not computed; set SimulationCfg(observables=('body_qdd',))")
        return self._sim.per_env(reported)[:, self._layout.body_slice]

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

    def set_defaults(self, lin_vel: Sequence[float], ang_vel: Sequence[float], origins: torch.Tensor) -> None:
        """Fill the defaults from the state as built and the config's initial velocities.

        Args:
            lin_vel: Velocity of the root's centre of mass, world frame [m/s].
            ang_vel: Angular velocity of the root, world frame [rad/s].
            origins: Origins of the environments [m], shape ``(num_envs, 3)``.
        """
        self._default_mass = self._body_mass.clone()
        self.default_root_state = self.root_state_w.clone()
        self.default_root_state[:, :3] -= origins
        for columns, velocity in ((slice(7, 10), lin_vel), (slice(10, 13), ang_vel)):
            self.default_root_state[:, columns] = torch.tensor(velocity, device=origins.device)

    # -- for terms

    @property
    def struct(self) -> kernels.ArticulationData:
        """The state as the struct that Warp terms read; its arrays are the simulation's own memory."""
        return self._made_struct()[0]

    @property
    def unavailable(self) -> dict[str, str]:
        """Fields of :attr:`struct` that may not be read, with the reason and what to set."""
        return self._made_struct()[1]

    _struct: tuple[kernels.ArticulationData, dict[str, str]] | None = None
    _struct_has_wrench = False

    def _made_struct(self) -> tuple[kernels.ArticulationData, dict[str, str]]:
        has_wrench = self._sim.external_wrench is not None
        if self._struct is None or self._struct_has_wrench != has_wrench:  # wrenches may be enabled at any time
            struct, unavailable = kernels.ArticulationData(), dict[str, str]()
            self._fill_struct(struct, unavailable)
            self._struct, self._struct_has_wrench = (struct, unavailable), has_wrench
        return self._struct

    def _fill_struct(self, struct: kernels.ArticulationData, unavailable: dict[str, str]) -> None:
        """Fill the struct with views of the simulation's arrays, and note which of its fields are not there."""
        sim, bodies = self._sim, self._layout.body_slice
        if not isinstance(bodies, slice):
            path = self._layout.path
            raise RuntimeError(f"'{path}': its bodies are not contiguous in the model, terms cannot read them")
        struct.root_pose = wp.from_torch(self.root_pose_w, dtype=wp.transform)
        struct.root_vel = wp.from_torch(self.root_vel_w, dtype=wp.spatial_vector)
        struct.default_root_pose = wp.from_torch(self.default_root_state[:, :7], dtype=wp.transform)
        struct.default_root_vel = wp.from_torch(self.default_root_state[:, 7:], dtype=wp.spatial_vector)
        struct.body_pose = self._warp_view(sim.state.body_q, bodies, wp.transform)
        struct.body_vel = self._warp_view(sim.state.body_qd, bodies, wp.spatial_vector)
        for name, observable in (("body_acc", "body_qdd"), ("body_parent_wrench", "body_parent_f")):
            array = sim.reported(observable)
            if array is None:
                unavailable[name] = f"not computed; set SimulationCfg(observables=('{observable}',))"
            else:
                setattr(struct, name, self._warp_view(array, bodies, wp.spatial_vector))
        if sim.external_wrench is None:
            unavailable["external_wrench"] = "not enabled; call sim.enable_external_wrench() first"
        else:
            struct.external_wrench = self._warp_view(sim.external_wrench, bodies, wp.spatial_vector)
        self._fill_joints(struct, unavailable)
        struct.physics_dt = sim.physics_dt
        struct.env_origin = sim.env_origin
        struct.gravity_dir = wp.vec3(*self.GRAVITY_VEC_W[0].tolist())

    def _fill_joints(self, struct: kernels.ArticulationData, unavailable: dict[str, str]) -> None:
        """Fill the fields about joints; without any they are empty."""
        empty = wp.zeros((self._sim.num_envs, 0), dtype=wp.float32, device=self._sim.device)
        for name in _JOINT_FIELDS:
            setattr(struct, name, empty)
        struct.soft_limit_factor = 1.0

    def _warp_view(self, array: wp.array | None, rows: slice, dtype: type) -> wp.array:
        """Some rows of each environment's part of a flat array; None for what the model has not."""
        if array is None or not array.size:
            return None
        return wp.from_torch(self._sim.per_env(array)[:, rows], dtype=dtype)
