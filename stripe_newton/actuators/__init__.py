# SPDX-License-Identifier: Apache-2.0
"""Actuators: turn the targets of joints into efforts."""

from .actuator_cfg import ActuatorCfg, ImplicitActuatorCfg
from .explicit_actuators import (
    DCMotorCfg,
    DelayedPDActuatorCfg,
    IdealPDActuatorCfg,
    PIDActuatorCfg,
    RemotizedPDActuatorCfg,
)
from .network_actuators import ActuatorNetLSTMCfg, ActuatorNetMLPCfg

__all__ = [
    "ActuatorCfg",
    "ActuatorNetLSTMCfg",
    "ActuatorNetMLPCfg",
    "DCMotorCfg",
    "DelayedPDActuatorCfg",
    "IdealPDActuatorCfg",
    "ImplicitActuatorCfg",
    "PIDActuatorCfg",
    "RemotizedPDActuatorCfg",
]
