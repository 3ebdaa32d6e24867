# SPDX-License-Identifier: Apache-2.0
"""Sensors: what the robots of a scene measure."""

from .sensor_base import SensorBase, SensorBaseCfg

__all__ = ["SensorBase", "SensorBaseCfg"]
