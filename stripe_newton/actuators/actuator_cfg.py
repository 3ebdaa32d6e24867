# SPDX-License-Identifier: Apache-2.0
"""Actuator configs: the base of all, and the drive inside the solver.

A config writes its group of joints onto the builder of one environment, before that is replicated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import newton

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.matching import match_names, match_values
from stripe_newton.value_types import AnyFloat

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["ActuatorCfg", "ImplicitActuatorCfg", "PerJoint", "PerJointLimit"]

_SMALLEST_EFFORT = 1.0e-5
"""Limit of a drive whose config or file gives it no effort [N or N m]."""

PerJoint = float | dict[str, float] | None
"""One number for all joints of the group, or numbers by joint-name expression; ``None`` keeps those of the file."""
PerJointLimit = AnyFloat | dict[str, AnyFloat] | None
"""As :data:`PerJoint`, and infinity is no limit."""


@configclass
class ActuatorCfg:
    """Base of the actuators: a group of joints, their limits and their passive properties."""

    joint_names_expr: str | list[str] = MISSING
    """Regular expressions of the joints in this group."""
    stiffness: PerJoint = None
    """Position gain [N/m or N m/rad]."""
    damping: PerJoint = None
    """Velocity gain [N s/m or N m s/rad]."""
    effort_limit: PerJointLimit = None
    """Largest effort [N or N m]."""
    effort_limit_sim: PerJointLimit = None
    """Limit of the solver's drive [N or N m]. It defaults to ``effort_limit``. An explicit actuator uses it only where
    ``effort_limit`` is ``None``."""
    velocity_limit: PerJointLimit = None
    """Speed the actuator is rated for [m/s or rad/s]; reported as ``joint_vel_limits``."""
    velocity_limit_sim: PerJointLimit = None
    """Speed that the joint is held to after every physics step [m/s or rad/s]."""
    armature: PerJoint = None
    """Inertia added to the joint [kg or kg m^2]."""
    friction: PerJoint = None
    """Coulomb friction of the joint [N or N m]."""
    viscous_friction: PerJoint = None
    """Passive damping of the joint [N s/m or N m s/rad]."""

    _not_negative: ClassVar[tuple[str, ...]] = (
        "stiffness", "damping", "effort_limit", "effort_limit_sim", "velocity_limit", "velocity_limit_sim", "armature",
        "friction", "viscous_friction",
    )  # fmt: skip

    def problems(self) -> Iterator[tuple[str, str]]:
        for name in self._not_negative:
            value = getattr(self, name)
            for key, number in value.items() if isinstance(value, Mapping) else [("", value)]:
                if number is not None and number is not MISSING and number < 0:
                    yield f"{name}[{key!r}]" if key else name, f"is {number}, must not be negative"

    def apply(self, builder: newton.ModelBuilder, names: Sequence[str], dofs: Sequence[int]) -> list[int]:
        """Write this group onto the builder; explicit actuators that the file has for its joints are replaced.

        Args:
            builder: Builder of one environment.
            names: Names of the articulation's joints, one a degree of freedom.
            dofs: Their indices into the builder's ``joint_qd``-shaped lists.

        Returns:
            Indices into ``names`` of the joints in this group.

        Raises:
            ValueError: if an expression matches no joint.
        """
        ids, own = match_names(self.joint_names_expr, names, what="joint")
        self._set(builder.joint_armature, self.armature, own, ids, dofs)
        self._set(builder.joint_friction, self.friction, own, ids, dofs)
        self._set(builder.joint_damping, self.viscous_friction, own, ids, dofs)
        # MuJoCo does not enforce the model's limit, which is a report; velocity_limit_sim is enforced after each step.
        limit = self.velocity_limit_sim if self.velocity_limit_sim is not None else self.velocity_limit
        self._set(builder.joint_velocity_limit, limit, own, ids, dofs)
        rows = [dofs[i] for i in ids]
        # The gains of an actuator of the file stay, for a config that leaves its own None.
        for row, gains in remove_actuators(builder, rows).items():
            builder.joint_target_ke[row], builder.joint_target_kd[row] = gains
        self._drive(builder, own, rows)
        return ids

    def _set(self, array: list[float], values: PerJoint, own: list[str], ids: list[int], dofs: Sequence[int]) -> None:
        if values is not None:
            for i, value in match_values(values, own, what="joint").items():
                array[dofs[ids[i]]] = value

    def _drive(self, builder: newton.ModelBuilder, names: list[str], dofs: list[int]) -> None:
        """Write the law of the joints, named ``names``, of the degrees of freedom ``dofs``."""
        raise NotImplementedError

    def bind(self, sim: Simulation, names: Sequence[str], dofs: Sequence[int]) -> None:
        """Finish what needs the model, once it is there.

        Args:
            sim: The simulation.
            names: Names of the articulation's joints, one a degree of freedom.
            dofs: Their degrees of freedom in an environment.
        """

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

    def _drive(self, builder: newton.ModelBuilder, names: list[str], dofs: list[int]) -> None:
        every = range(len(names))
        self._set(builder.joint_target_ke, self.stiffness, names, list(every), dofs)
        self._set(builder.joint_target_kd, self.damping, names, list(every), dofs)
        limit = self.effort_limit_sim if self.effort_limit_sim is not None else self.effort_limit
        self._set(builder.joint_effort_limit, limit, names, list(every), dofs)
        for dof in dofs:
            # MuJoCo takes no empty range: a drive without effort has next to none.
            builder.joint_effort_limit[dof] = max(builder.joint_effort_limit[dof], _SMALLEST_EFFORT)
            gains = builder.joint_target_ke[dof], builder.joint_target_kd[dof]
            # SolverMuJoCo makes the drives of a joint by its mode, and reads the gains afterwards.
            builder.joint_target_mode[dof] = int(newton.JointTargetMode.from_gains(*gains, has_drive=True))


def remove_actuators(builder: newton.ModelBuilder, dofs: Sequence[int]) -> dict[int, tuple[float, float]]:
    """Take the explicit actuators of some degrees of freedom off a builder.

    Returns:
        The position and velocity gains that they had, by degree of freedom.
    """
    gains = {}
    for key, entry in list(builder.actuator_entries.items()):
        kept = [k for k, dof in enumerate(entry.indices) if dof not in dofs]
        for dof, arguments in zip(entry.indices, entry.drive_args, strict=True):
            if dof in dofs:
                gains[dof] = arguments.get("kp", 0.0), arguments.get("kd", 0.0)
        # An entry is one of lists side by side; those that do not apply, such as the delays, are empty.
        for name in ("indices", "pos_indices", "drive_args", "delay_args", "clamping_args"):
            values = getattr(entry, name)
            values[:] = [values[k] for k in kept] if values else []
        if not kept:
            del builder.actuator_entries[key]
    return gains
