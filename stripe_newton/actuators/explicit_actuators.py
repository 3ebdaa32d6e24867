# SPDX-License-Identifier: Apache-2.0
"""Explicit actuators: laws that are evaluated before every physics step, made of Newton's actuator library."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import newton
from newton.actuators import ClampingDCMotor, ClampingMaxEffort, ClampingPositionBased, DrivePD, DrivePID

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.matching import match_names, match_values
from stripe_newton.value_types import NonNegativeInt

from .actuator_cfg import ActuatorCfg, PerJoint, PerJointLimit
from .drive_table import coordinate

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = [
    "DCMotorCfg",
    "DelayedPDActuatorCfg",
    "IdealPDActuatorCfg",
    "PIDActuatorCfg",
    "RemotizedPDActuatorCfg",
]

Part = tuple[type, dict[str, object]]
"""A drive or a clamp of Newton's, and its arguments."""
Law = Callable[[dict[str, float]], Part]
"""The drive of a joint, from the joint's numbers."""


@configclass
class IdealPDActuatorCfg(ActuatorCfg):
    """An explicit PD law with limited effort.

    ``effort = clamp(stiffness (q* - q) + damping (qd* - qd) + effort target, -effort_limit, effort_limit)``
    """

    def _drive(self, builder: newton.ModelBuilder, names: list[str], dofs: list[int]) -> None:
        # What the config leaves out is what the file says, read before the loop overwrites it.
        numbers = {name: self._by_joint(name, names, _of_file(builder, name, dofs)) for name in self._needs()}
        law = self._law()
        for i, dof in enumerate(dofs):
            coord = coordinate(builder.joint_type, builder.joint_q_start, builder.joint_qd_start, dof)
            if coord < 0:
                raise ValueError(f"joint '{names[i]}' is a ball joint, which ImplicitActuatorCfg alone drives")
            joint = {name: values[i] for name, values in numbers.items()}
            # The solver must not drive the joint too: without gains and in this mode it passes efforts on.
            builder.joint_target_ke[dof] = builder.joint_target_kd[dof] = 0.0
            builder.joint_target_mode[dof] = int(newton.JointTargetMode.EFFORT)
            builder.joint_effort_limit[dof] = joint["effort_limit"]
            kind, arguments = law(joint)
            delay, limits = self._delay(), self._limits(joint)
            builder.add_actuator(
                kind, index=dof, pos_index=coord, clamping=limits, delay_steps=delay or None, **arguments
            )

    def _by_joint(self, name: str, names: Sequence[str], default: Sequence[float] | None) -> list[float]:
        given = getattr(self, name)
        if name == "effort_limit" and given is None:
            given = self.effort_limit_sim
        found = match_values(given, names, what="joint") if given is not None else {}
        for i, joint in enumerate(names):
            if i in found:
                continue
            if default is None:
                raise ValueError(f"{name}: has no value for joint '{joint}'")
            found[i] = default[i]
        return [found[i] for i in range(len(names))]

    def _needs(self) -> tuple[str, ...]:
        """Fields that every joint needs a number of."""
        return "stiffness", "damping", "effort_limit"

    def _law(self) -> Law:
        return lambda joint: (DrivePD, {"kp": joint["stiffness"], "kd": joint["damping"]})

    def _limits(self, joint: dict[str, float]) -> list[Part]:
        return [(ClampingMaxEffort, {"max_effort": joint["effort_limit"]})]

    def _delay(self) -> int:
        return 0


def _of_file(builder: newton.ModelBuilder, name: str, dofs: Sequence[int]) -> list[float] | None:
    """Values that the file gives a field of the config; None for fields that no file has."""
    arrays = {
        "stiffness": builder.joint_target_ke, "damping": builder.joint_target_kd,
        "effort_limit": builder.joint_effort_limit,
    }  # fmt: skip
    return [float(arrays[name][dof]) for dof in dofs] if name in arrays else None


@configclass
class PIDActuatorCfg(IdealPDActuatorCfg):
    """A PD law with an integral: ``I`` grows by ``dt (q* - q)`` in each physics step and starts an episode at zero.

    ``effort = clamp(stiffness (q* - q) + integral_gain I + damping (qd* - qd) + effort target, +-effort_limit)``
    """

    integral_gain: PerJoint = 0.0
    """Gain of the integrated position error [N/(m s) or N m/(rad s)]."""
    integral_limit: PerJointLimit = math.inf
    """Largest integrated position error, against wind-up [m s or rad s]."""

    _not_negative: ClassVar[tuple[str, ...]] = (*ActuatorCfg._not_negative, "integral_gain", "integral_limit")

    def _needs(self) -> tuple[str, ...]:
        return (*super()._needs(), "integral_gain", "integral_limit")

    def _law(self) -> Law:
        def law(joint: dict[str, float]) -> Part:
            gains = {"kp": joint["stiffness"], "ki": joint["integral_gain"], "kd": joint["damping"]}
            return DrivePID, {**gains, "integral_max": joint["integral_limit"]}

        return law


@configclass
class DCMotorCfg(IdealPDActuatorCfg):
    """A PD law whose effort is limited by the torque-speed curve of a DC motor.

    The effort lies between ``max(s (-1 - qd/v), -effort_limit)`` and ``min(s (1 - qd/v), effort_limit)``, where ``s``
    is the ``saturation_effort`` and ``v`` the ``velocity_limit``.
    """

    saturation_effort: PerJointLimit = MISSING
    """Effort of the motor at standstill [N or N m]."""

    _not_negative: ClassVar[tuple[str, ...]] = (*ActuatorCfg._not_negative, "saturation_effort")

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.saturation_effort is None or self.saturation_effort is MISSING:
            return
        if self.velocity_limit is None:
            yield "velocity_limit", "is missing: a DC motor needs the speed at which its effort vanishes"
        for name in ("velocity_limit", "saturation_effort"):
            value = getattr(self, name)
            for key, number in value.items() if isinstance(value, Mapping) else [("", value)]:
                if isinstance(number, (int, float)) and (number == 0 or math.isinf(number)):
                    yield f"{name}[{key!r}]" if key else name, f"is {number}, must be positive and finite"

    def _needs(self) -> tuple[str, ...]:
        curve = ("saturation_effort", "velocity_limit") if self.saturation_effort is not None else ()
        return (*super()._needs(), *curve)

    def _limits(self, joint: dict[str, float]) -> list[Part]:
        if "saturation_effort" not in joint:
            return super()._limits(joint)
        numbers = {name: joint[name] for name in ("saturation_effort", "velocity_limit")}
        return [(ClampingDCMotor, {**numbers, "max_motor_effort": joint["effort_limit"]})]


@configclass
class DelayedPDActuatorCfg(IdealPDActuatorCfg):
    """A PD law whose targets (position, velocity and effort) arrive late.

    The delay of an environment is drawn when its episode begins, uniformly from ``min_delay`` to ``max_delay``, and is
    the same for all joints of the group. Until the episode is as old as the delay, its first targets hold.
    """

    min_delay: NonNegativeInt = 0
    """Least delay [physics steps]."""
    max_delay: NonNegativeInt = 0
    """Largest delay [physics steps]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        for name in ("min_delay", "max_delay"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 0:
                yield name, f"is {value!r}, must be a whole number of physics steps, 0 or more"
                return
        if self.min_delay > self.max_delay:
            yield "min_delay", f"is {self.min_delay}, must not be larger than max_delay, which is {self.max_delay}"

    def _delay(self) -> int:
        return self.max_delay  # the depth of the buffer; bind() has lags drawn below it

    def bind(self, sim: Simulation, names: Sequence[str], dofs: Sequence[int]) -> None:
        if self.max_delay:
            ids = match_names(self.joint_names_expr, names, what="joint")[0]
            sim.actuation.delay([dofs[i] for i in ids], self.min_delay, self.max_delay)


@configclass
class RemotizedPDActuatorCfg(DelayedPDActuatorCfg):
    """A delayed PD law behind a linkage: the largest effort at the joint depends on the joint's position.

    The limit is interpolated linearly in the table, and constant beyond its ends. An ``effort_limit`` holds too.
    """

    joint_parameter_lookup: list[list[float]] = MISSING
    """Rows of joint position [m or rad], rising, transmission ratio (unused) and largest effort [N or N m]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        table = self.joint_parameter_lookup
        if table is MISSING:
            return
        if not len(table) or any(len(row) != 3 for row in table):
            yield "joint_parameter_lookup", "must have rows of three numbers: position, transmission ratio, effort"
            return
        if not all(math.isfinite(number) for row in table for number in row):
            yield "joint_parameter_lookup", "has numbers that are not finite"
        if any(b[0] <= a[0] for a, b in itertools.pairwise(table)):
            yield "joint_parameter_lookup", "has positions, the first numbers of its rows, that do not rise"
        if any(row[2] < 0 for row in table):
            yield "joint_parameter_lookup", "has negative efforts, the third numbers of its rows"

    def _by_joint(self, name: str, names: Sequence[str], default: Sequence[float] | None) -> list[float]:
        if name == "effort_limit":
            default = [max(float(row[2]) for row in self.joint_parameter_lookup)] * len(names)
        return super()._by_joint(name, names, default)

    def _limits(self, joint: dict[str, float]) -> list[Part]:
        positions, _, efforts = zip(*((float(x) for x in row) for row in self.joint_parameter_lookup))
        table: dict[str, object] = {"lookup_positions": positions, "lookup_efforts": efforts}
        return [*super()._limits(joint), (ClampingPositionBased, table)]
