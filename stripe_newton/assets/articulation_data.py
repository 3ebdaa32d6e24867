# SPDX-License-Identifier: Apache-2.0
"""Articulation data: state of an articulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import warp as wp

import stripe_kernels.data as kernels

from .root_data import RootData

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

    from .layout import Layout

__all__ = ["ArticulationData"]

_MODEL_FIELDS = {
    "joint_stiffness": "joint_target_ke",
    "joint_damping": "joint_target_kd",
    "joint_pos_lower": "joint_limit_lower",
    "joint_pos_upper": "joint_limit_upper",
    "joint_vel_limit": "joint_velocity_limit",
    "joint_effort_limit": "joint_effort_limit",
}
"""Fields of the struct, and the arrays of the model that they show."""


class ArticulationData(RootData):
    """:class:`RootData` and the joints, one column a degree of freedom, in the order of ``joint_names``.

    A ball joint has four position columns (a quaternion) for its three degrees of freedom.
    """

    default_joint_pos: torch.Tensor
    """Positions at the start of an episode [m or rad], shape ``(num_envs, num_joints)``."""
    default_joint_vel: torch.Tensor
    """Velocities at the start of an episode [m/s or rad/s], shape ``(num_envs, num_joints)``."""

    def __init__(self, sim: Simulation, layout: Layout, soft_limit_factor: float):
        super().__init__(sim, layout)
        self._coords = coords = slice(layout.coords.start, layout.coords.stop)
        self._dofs = dofs = slice(layout.dofs.start, layout.dofs.stop)
        state, model, control = sim.state, sim.model, sim.control
        self.joint_pos = sim.per_env(state.joint_q)[:, coords]
        """Joint positions [m or rad] (view), shape ``(num_envs, num_joints)``."""
        self.joint_vel = sim.per_env(state.joint_qd)[:, dofs]
        """Joint velocities [m/s or rad/s] (view), shape ``(num_envs, num_joints)``."""
        self.joint_pos_target = sim.per_env(control.joint_target_q)[:, coords]
        """Position targets [m or rad] (view), shape ``(num_envs, num_joints)``."""
        self.joint_vel_target = sim.per_env(control.joint_target_qd)[:, dofs]
        """Velocity targets [m/s or rad/s] (view), shape ``(num_envs, num_joints)``."""
        self.joint_effort_target = sim.per_env(control.joint_act)[:, dofs]
        """Effort targets [N or N m] (view), shape ``(num_envs, num_joints)``."""
        self.joint_stiffness = sim.per_env(model.joint_target_ke)[:, dofs]
        """Position gains, implicit or explicit [N/m or N m/rad] (view), shape ``(num_envs, num_joints)``."""
        self.joint_damping = sim.per_env(model.joint_target_kd)[:, dofs]
        """Velocity gains, implicit or explicit [N s/m or N m s/rad] (view), shape ``(num_envs, num_joints)``."""
        self.joint_armature = sim.per_env(model.joint_armature)[:, dofs]
        """Inertia added to the joints [kg or kg m^2] (view), shape ``(num_envs, num_joints)``."""
        self.joint_friction_coeff = sim.per_env(model.joint_friction)[:, dofs]
        """Coulomb friction of the joints [N or N m] (view), shape ``(num_envs, num_joints)``."""
        self.joint_viscous_friction_coeff = sim.per_env(model.joint_damping)[:, dofs]
        """Passive damping of the joints [N s/m or N m s/rad] (view), shape ``(num_envs, num_joints)``."""
        self.joint_effort_limits = sim.per_env(model.joint_effort_limit)[:, dofs]
        """Largest efforts [N or N m] (view), shape ``(num_envs, num_joints)``."""
        self.joint_vel_limits = sim.per_env(model.joint_velocity_limit)[:, dofs]
        """Rated speeds [m/s or rad/s] (view), shape ``(num_envs, num_joints)``."""
        self._lower = sim.per_env(model.joint_limit_lower)[:, dofs]
        self._upper = sim.per_env(model.joint_limit_upper)[:, dofs]
        # Of explicit actuators MuJoCo reports nothing: their efforts are part of joint_f.
        self._explicit = torch.from_numpy(sim.actuation.explicit[dofs]).to(sim.device)
        self._soft = soft_limit_factor
        self._previous_vel = sim.per_env(sim.previous_joint_qd)[:, dofs]
        self.default_joint_stiffness = self.joint_stiffness.clone()
        """:attr:`joint_stiffness` as built."""
        self.default_joint_damping = self.joint_damping.clone()
        """:attr:`joint_damping` as built."""
        self.default_joint_armature = self.joint_armature.clone()
        """:attr:`joint_armature` as built."""
        self.default_joint_friction_coeff = self.joint_friction_coeff.clone()
        """:attr:`joint_friction_coeff` as built."""
        self.default_joint_viscous_friction_coeff = self.joint_viscous_friction_coeff.clone()
        """:attr:`joint_viscous_friction_coeff` as built."""

    @property
    def joint_acc(self) -> torch.Tensor:
        """Accelerations over the last physics step [m/s^2 or rad/s^2], shape ``(num_envs, num_joints)``."""
        return (self.joint_vel - self._previous_vel) / self._sim.physics_dt

    @property
    def joint_pos_limits(self) -> torch.Tensor:
        """Lower and upper limits [m or rad], shape ``(num_envs, num_joints, 2)``; +-1e10 where there is none."""
        return torch.stack((self._lower, self._upper), dim=-1)

    @property
    def default_joint_pos_limits(self) -> torch.Tensor:
        """:attr:`joint_pos_limits`."""
        return self.joint_pos_limits

    @property
    def soft_joint_pos_limits(self) -> torch.Tensor:
        """Limits narrowed by ``soft_joint_pos_limit_factor`` about their middle, ``(num_envs, num_joints, 2)``."""
        middle = 0.5 * (self._lower + self._upper)
        half = 0.5 * self._soft * (self._upper - self._lower)
        return torch.stack((middle - half, middle + half), dim=-1)

    @property
    def soft_joint_vel_limits(self) -> torch.Tensor:
        """:attr:`joint_vel_limits`, shape ``(num_envs, num_joints)``."""
        return self.joint_vel_limits

    @property
    def computed_torque(self) -> torch.Tensor:
        """Efforts that the laws of drives and actuators asked for in the last physics step [N or N m], unlimited.

        Shape ``(num_envs, num_joints)``. For implicit drives it is their law at the state before the step, which the
        solver integrates implicitly: for them it is an estimate.
        """
        return self._sim.per_env(self._sim.actuation.computed_effort)[:, self._dofs]

    @property
    def applied_torque(self) -> torch.Tensor:
        """Efforts of drives and actuators in the last physics step [N or N m], shape ``(num_envs, num_joints)``.

        For implicit drives what MuJoCo reports, where it is the solver; with others :attr:`computed_torque`, limited.
        """
        sim = self._sim
        other = sim.per_env(sim.control.joint_f)[:, self._dofs]
        reported = sim.reported("qfrc_actuator")
        if reported is not None:
            return sim.per_env(reported)[:, self._dofs] + other
        law = self.computed_torque.clamp(-self.joint_effort_limits, self.joint_effort_limits)
        return torch.where(self._explicit, other, law)

    def _fill_joints(self, struct: kernels.ArticulationData, unavailable: dict[str, str]) -> None:
        super()._fill_joints(struct, unavailable)
        struct.soft_limit_factor = self._soft
        if not self.joint_names:
            return
        sim, coords, dofs = self._sim, self._coords, self._dofs
        struct.joint_pos = self._warp_view(sim.state.joint_q, coords, wp.float32)
        struct.joint_vel = self._warp_view(sim.state.joint_qd, dofs, wp.float32)
        struct.previous_joint_vel = self._warp_view(sim.previous_joint_qd, dofs, wp.float32)
        struct.default_joint_pos = wp.from_torch(self.default_joint_pos)
        struct.default_joint_vel = wp.from_torch(self.default_joint_vel)
        struct.joint_pos_target = self._warp_view(sim.control.joint_target_q, coords, wp.float32)
        struct.joint_vel_target = self._warp_view(sim.control.joint_target_qd, dofs, wp.float32)
        struct.joint_effort_target = self._warp_view(sim.control.joint_act, dofs, wp.float32)
        struct.joint_other_effort = self._warp_view(sim.control.joint_f, dofs, wp.float32)
        for name, array in _MODEL_FIELDS.items():
            setattr(struct, name, self._warp_view(getattr(sim.model, array), dofs, wp.float32))
        effort = sim.reported("qfrc_actuator")
        if effort is None:
            unavailable["joint_drive_effort"] = f"{type(sim.solver).__name__} does not report it, use MuJoCoSolverCfg"
        else:
            struct.joint_drive_effort = self._warp_view(effort, dofs, wp.float32)
