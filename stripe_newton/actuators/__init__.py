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
from .torch_actuators import JointGroup, TorchActuatorCfg, TorchLaw
from .torch_targets import TargetLaw, TorchTargetsCfg

__all__ = [
    "ActuatorCfg",
    "ActuatorNetLSTMCfg",
    "ActuatorNetMLPCfg",
    "DCMotorCfg",
    "DelayedPDActuatorCfg",
    "IdealPDActuatorCfg",
    "ImplicitActuatorCfg",
    "JointGroup",
    "PIDActuatorCfg",
    "RemotizedPDActuatorCfg",
    "TargetLaw",
    "TorchActuatorCfg",
    "TorchLaw",
    "TorchTargetsCfg",
]
