# SPDX-License-Identifier: Apache-2.0
"""Actuators: what turns the targets of joints into forces."""

from .actuator_cfg import ActuatorCfg, IdealPDActuatorCfg, ImplicitActuatorCfg

__all__ = ["ActuatorCfg", "IdealPDActuatorCfg", "ImplicitActuatorCfg"]
