# SPDX-License-Identifier: Apache-2.0
"""Config of the operational space controller."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from stripe_newton.configclass import MISSING, configclass

__all__ = ["TARGET_SIZES", "OperationalSpaceControllerCfg"]

TARGET_SIZES = {"pose_abs": 7, "pose_rel": 6, "wrench_abs": 6}
"""Size of each kind of target."""

_CHOICES = {"impedance_mode": ("fixed", "variable_kp", "variable"), "nullspace_control": ("none", "position")}


@configclass
class OperationalSpaceControllerCfg:
    """Config of operational space control: joint efforts that move a body, or press with it.

    "Task" names the frame in which targets, axes and gains are given. Six numbers are three along and three about its
    axes.
    """

    target_types: Sequence[str] = MISSING
    """Targets in the order of the command: ``"pose_abs"`` or ``"pose_rel"``, and ``"wrench_abs"``."""

    motion_control_axes_task: Sequence[int] = (1, 1, 1, 1, 1, 1)
    """1 for the axes whose motion is controlled, 0 for others."""

    contact_wrench_control_axes_task: Sequence[int] = (0, 0, 0, 0, 0, 0)
    """1 for the axes whose force or torque is controlled, 0 for others."""

    inertial_dynamics_decoupling: bool = False
    """Whether efforts account for the inertia of the robot as felt at the body, so that gains are accelerations for
    each unit of error. It needs the mass matrix."""

    partial_inertial_dynamics_decoupling: bool = False
    """Whether that inertia leaves out the coupling of translation and rotation. It has no effect without
    ``inertial_dynamics_decoupling``."""

    gravity_compensation: bool = False
    """Whether the gravity forces that are handed in are added to the efforts."""

    impedance_mode: str = "fixed"
    """``"fixed"`` gains; ``"variable_kp"``, stiffness in the command; or ``"variable"``, damping ratio too."""

    motion_stiffness_task: float | Sequence[float] = (100.0, 100.0, 100.0, 100.0, 100.0, 100.0)
    """Stiffness: one number, or six."""

    motion_damping_ratio_task: float | Sequence[float] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """Damping ratio: one number, or six. The damping is ``2 sqrt(stiffness) ratio``."""

    motion_stiffness_limits_task: tuple[float, float] = (0, 1000)
    """Least and greatest stiffness that a command may set."""

    motion_damping_ratio_limits_task: tuple[float, float] = (0, 100)
    """Least and greatest damping ratio that a command may set."""

    contact_wrench_stiffness_task: float | Sequence[float] | None = None
    """Gain on the force error: one number, or six, of which the first three count, since torques at the contact are
    not measured. None applies the wrench without feedback."""

    nullspace_control: str = "none"
    """Use of the joints' freedom that is left: ``"none"``, or ``"position"`` towards joint positions."""

    nullspace_stiffness: float = 10.0
    """Stiffness of the null space control."""

    nullspace_damping_ratio: float = 1.0
    """Damping ratio of the null space control."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield invalid fields as ``(field, message)``."""
        if self.target_types is not MISSING:
            yield from self._target_problems()
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                yield name, f"is {getattr(self, name)!r}, must be one of {', '.join(map(repr, choices))}"
        for name in ("motion_control_axes_task", "contact_wrench_control_axes_task"):
            axes = getattr(self, name)
            if len(axes) != 6 or any(axis not in (0, 1) for axis in axes):
                yield name, f"is {axes}, must be six numbers, each 0 or 1"
        for name in ("motion_stiffness_task", "motion_damping_ratio_task", "contact_wrench_stiffness_task"):
            value = getattr(self, name)
            numbers = value if isinstance(value, Sequence) else [0.0 if value is None else value]
            if len(numbers) not in (1, 6) or not all(math.isfinite(v) and v >= 0.0 for v in numbers):
                yield name, f"is {value}, must be one number or six, 0 or more"
        for name in ("nullspace_stiffness", "nullspace_damping_ratio"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                yield name, f"is {getattr(self, name)}, must be 0 or more"
        for name in ("motion_stiffness_limits_task", "motion_damping_ratio_limits_task"):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high:
                yield name, f"is {(low, high)}, must be (least, greatest), both 0 or more"

    def _target_problems(self) -> Iterator[tuple[str, str]]:
        kinds = [str(name).partition("_")[0] for name in self.target_types]
        unknown = [name for name in self.target_types if name not in TARGET_SIZES]
        if unknown or not kinds:
            yield "target_types", f"is {list(self.target_types)}, must be of {', '.join(map(repr, TARGET_SIZES))}"
        elif len(set(kinds)) < len(kinds):
            yield "target_types", f"is {list(self.target_types)}, must have one pose and one wrench at most"
