# SPDX-License-Identifier: Apache-2.0
"""Actuator configs, written onto the joints of a Newton model builder before it is replicated."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.matching import match_names, match_values

if TYPE_CHECKING:
    import newton

__all__ = ["ActuatorCfg", "IdealPDActuatorCfg", "ImplicitActuatorCfg"]

PerJoint = float | dict[str, float] | None
"""One number for all joints of the group, or numbers by joint-name expression; ``None`` keeps what the file says."""

_NON_NEGATIVE = (
    "stiffness",
    "damping",
    "effort_limit",
    "effort_limit_sim",
    "velocity_limit",
    "velocity_limit_sim",
    "armature",
    "friction",
    "viscous_friction",
)


@configclass
class ActuatorCfg:
    """Base of the actuators: which joints, their limits and their passive properties."""

    joint_names_expr: list[str] = MISSING
    """Regular expressions of the joints in this group."""
    stiffness: PerJoint = None
    """Position gain [N/m or N m/rad]."""
    damping: PerJoint = None
    """Velocity gain [N s/m or N m s/rad]."""
    effort_limit: PerJoint = None
    """Largest effort [N or N m]."""
    effort_limit_sim: PerJoint = None
    """Largest effort the solver lets the drive apply [N or N m]; default: ``effort_limit``."""
    velocity_limit: PerJoint = None
    """Speed the actuator is rated for [m/s or rad/s]; reported as ``joint_vel_limits``."""
    velocity_limit_sim: PerJoint = None
    """Speed that the joint is held to after every physics step [m/s or rad/s]."""
    armature: PerJoint = None
    """Inertia added to the joint [kg or kg m^2]."""
    friction: PerJoint = None
    """Coulomb friction of the joint [N or N m]."""
    viscous_friction: PerJoint = None
    """Passive damping of the joint [N s/m or N m s/rad]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        for name in _NON_NEGATIVE:
            value = getattr(self, name)
            for key, number in value.items() if isinstance(value, Mapping) else [("", value)]:
                if number is None:
                    continue
                where = f"{name}[{key!r}]" if key else name
                if not isinstance(number, (int, float)) or math.isnan(number):
                    yield where, f"is {number!r}, must be a number"
                elif number < 0:
                    yield where, f"is {number}, must not be negative"

    def apply(
        self, builder: newton.ModelBuilder, names: Sequence[str], dofs: Sequence[int], coords: Sequence[int]
    ) -> list[int]:
        """Write this group onto the builder.

        Args:
            builder: Builder of one environment.
            names: Names of the articulation's joints, one a degree of freedom.
            dofs: Their indices into the builder's ``joint_qd``-shaped lists.
            coords: Their indices into the builder's ``joint_q``-shaped lists.

        Returns:
            Indices into ``names`` of the joints in this group.

        Raises:
            ValueError: if an expression matches no joint.
        """
        ids, own = match_names(self.joint_names_expr, names, what="joint")
        self._set(builder.joint_armature, self.armature, own, ids, dofs)
        self._set(builder.joint_friction, self.friction, own, ids, dofs)
        self._set(builder.joint_damping, self.viscous_friction, own, ids, dofs)
        limit = self.velocity_limit_sim if self.velocity_limit_sim is not None else self.velocity_limit
        self._set(builder.joint_velocity_limit, limit, own, ids, dofs)
        self._drive(builder, own, [dofs[i] for i in ids], [coords[i] for i in ids])
        return ids

    def _set(self, array: list[float], values: PerJoint, own: list[str], ids: list[int], dofs: Sequence[int]) -> None:
        if values is not None:
            for i, value in match_values(values, own, what="joint").items():
                array[dofs[ids[i]]] = value

    def _drive(self, builder: newton.ModelBuilder, names: list[str], dofs: list[int], coords: list[int]) -> None:
        raise NotImplementedError

    def limited_velocities(self, names: Sequence[str]) -> dict[int, float]:
        """Enforced speed limits by index into ``names``."""
        if self.velocity_limit_sim is None:
            return {}
        ids, own = match_names(self.joint_names_expr, names, what="joint")
        return {ids[i]: v for i, v in match_values(self.velocity_limit_sim, own, what="joint").items()}


@configclass
class ImplicitActuatorCfg(ActuatorCfg):
    """A drive inside the solver: position and velocity gains integrated implicitly, stable at any time step.

    ``effort = stiffness (q* - q) + damping (qd* - qd) + effort target``, the drive and the effort target each limited.
    """

    def _drive(self, builder: newton.ModelBuilder, names: list[str], dofs: list[int], coords: list[int]) -> None:
        import newton

        every = range(len(names))
        self._set(builder.joint_target_ke, self.stiffness, names, list(every), dofs)
        self._set(builder.joint_target_kd, self.damping, names, list(every), dofs)
        limit = self.effort_limit_sim if self.effort_limit_sim is not None else self.effort_limit
        self._set(builder.joint_effort_limit, limit, names, list(every), dofs)
        for dof in dofs:
            gains = builder.joint_target_ke[dof], builder.joint_target_kd[dof]
            builder.joint_target_mode[dof] = int(newton.JointTargetMode.from_gains(*gains, has_drive=True))


@configclass
class IdealPDActuatorCfg(ActuatorCfg):
    """An explicit PD law with limited effort, evaluated before every physics step by Newton's actuator library.

    ``effort = clamp(stiffness (q* - q) + damping (qd* - qd) + effort target, -effort_limit, effort_limit)``
    """

    def _drive(self, builder: newton.ModelBuilder, names: list[str], dofs: list[int], coords: list[int]) -> None:
        import newton
        from newton.actuators import ClampingMaxEffort, DrivePD

        gains = {}
        for field, array in (("stiffness", builder.joint_target_ke), ("damping", builder.joint_target_kd)):
            values = getattr(self, field)
            gains[field] = (
                match_values(values, names, what="joint")
                if values is not None
                else dict(enumerate(array[d] for d in dofs))
            )
        limits = match_values(self.effort_limit, names, what="joint") if self.effort_limit is not None else {}
        for i, (dof, coord) in enumerate(zip(dofs, coords, strict=True)):
            limit = limits.get(i, builder.joint_effort_limit[dof])
            builder.joint_target_ke[dof] = builder.joint_target_kd[dof] = 0.0
            builder.joint_target_mode[dof] = int(newton.JointTargetMode.EFFORT)
            builder.joint_effort_limit[dof] = limit
            builder.add_actuator(
                DrivePD,
                index=dof,
                pos_index=coord,
                clamping=[(ClampingMaxEffort, {"max_effort": limit})],
                kp=gains["stiffness"].get(i, 0.0),
                kd=gains["damping"].get(i, 0.0),
            )
