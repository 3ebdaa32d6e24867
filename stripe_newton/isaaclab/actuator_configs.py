# SPDX-License-Identifier: Apache-2.0
"""Actuator configs of the Isaac Lab dialect, whose ``class_type`` may be a class of the user's."""

from __future__ import annotations

from typing import ClassVar

from stripe_newton import actuators as native
from stripe_newton.actuators import JointGroup, TargetLaw, TorchLaw
from stripe_newton.actuators.torch_actuators import CallsTorchLaw
from stripe_newton.actuators.torch_targets import ChangesTargets
from stripe_newton.configclass import configclass

from . import actuators
from .actuators import ClassLaw, ClassTargets

__all__ = [
    "ActuatorNetLSTMCfg",
    "ActuatorNetMLPCfg",
    "DCMotorCfg",
    "DelayedPDActuatorCfg",
    "IdealPDActuatorCfg",
    "ImplicitActuatorCfg",
    "RemotizedPDActuatorCfg",
]

_STOCK = tuple(getattr(actuators, name) for name in actuators.__all__)
_DYNAMIC = {"dynamic_friction": "a joint has one Coulomb friction, the field friction"}


@configclass
class _OwnClass(CallsTorchLaw):
    """A config that calls its class where that is the user's."""

    class_type: type | None = None

    def calls_law(self) -> bool:
        return self.class_type is not None and self.class_type not in _STOCK

    def law_name(self) -> str:
        return getattr(self.class_type, "__name__", "")

    def make_law_of(self, group: JointGroup) -> TorchLaw:
        assert self.class_type is not None  # `calls_law` says so
        return ClassLaw(self, self.class_type, group)


@configclass
class IdealPDActuatorCfg(_OwnClass, native.IdealPDActuatorCfg):
    """:class:`stripe_newton.actuators.IdealPDActuatorCfg`."""

    class_type: type | None = actuators.IdealPDActuator
    dynamic_friction: float | dict[str, float] | None = None
    IGNORED: ClassVar[dict[str, str]] = _DYNAMIC


@configclass
class DCMotorCfg(_OwnClass, native.DCMotorCfg):
    """:class:`stripe_newton.actuators.DCMotorCfg`."""

    class_type: type | None = actuators.DCMotor
    dynamic_friction: float | dict[str, float] | None = None
    IGNORED: ClassVar[dict[str, str]] = _DYNAMIC


@configclass
class DelayedPDActuatorCfg(_OwnClass, native.DelayedPDActuatorCfg):
    """:class:`stripe_newton.actuators.DelayedPDActuatorCfg`."""

    class_type: type | None = actuators.DelayedPDActuator
    dynamic_friction: float | dict[str, float] | None = None
    IGNORED: ClassVar[dict[str, str]] = _DYNAMIC


@configclass
class RemotizedPDActuatorCfg(_OwnClass, native.RemotizedPDActuatorCfg):
    """:class:`stripe_newton.actuators.RemotizedPDActuatorCfg`."""

    class_type: type | None = actuators.RemotizedPDActuator
    dynamic_friction: float | dict[str, float] | None = None
    IGNORED: ClassVar[dict[str, str]] = _DYNAMIC


@configclass
class ImplicitActuatorCfg(ChangesTargets):
    """:class:`stripe_newton.actuators.ImplicitActuatorCfg`."""

    class_type: type | None = actuators.ImplicitActuator
    dynamic_friction: float | dict[str, float] | None = None
    IGNORED: ClassVar[dict[str, str]] = _DYNAMIC

    def calls_law(self) -> bool:
        return self.class_type is not None and self.class_type not in _STOCK

    def law_name(self) -> str:
        return getattr(self.class_type, "__name__", "")

    def make_law_of(self, group: JointGroup) -> TargetLaw:
        assert self.class_type is not None  # `calls_law` says so
        return ClassTargets(self, self.class_type, group)


@configclass
class ActuatorNetLSTMCfg(native.ActuatorNetLSTMCfg):
    """:class:`stripe_newton.actuators.ActuatorNetLSTMCfg`."""

    dynamic_friction: float | dict[str, float] | None = None
    IGNORED: ClassVar[dict[str, str]] = _DYNAMIC


@configclass
class ActuatorNetMLPCfg(native.ActuatorNetMLPCfg):
    """:class:`stripe_newton.actuators.ActuatorNetMLPCfg`."""

    dynamic_friction: float | dict[str, float] | None = None
    IGNORED: ClassVar[dict[str, str]] = _DYNAMIC
