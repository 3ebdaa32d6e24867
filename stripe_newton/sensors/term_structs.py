# SPDX-License-Identifier: Apache-2.0
"""Structs of sensors in terms: how a term finds its sensor, and what it may read of it."""

from __future__ import annotations

from collections.abc import Mapping

from stripe_newton.fusion import NamedStructs, SceneEntityCfg, StructRegistry, TermBinding
from stripe_newton.fusion.warp_types import Struct, struct_of

from .sensor_base import SensorBase

__all__ = ["register_sensor_structs"]


class SensorStructs(NamedStructs):
    """Finds a sensor by ``sensor_cfg``; its bodies are those that index arguments choose from by default."""

    def __init__(self, kind: Struct, sensors: Mapping[str, SensorBase]):
        super().__init__(kind, ["sensor_cfg"])
        self._sensors = sensors

    def chosen(self, binding: TermBinding, cfg: SceneEntityCfg) -> None:
        binding.sensor = cfg
        binding.check_available(self._sensors[cfg.name].unavailable, cfg.name)


def register_sensor_structs(structs: StructRegistry, sensors: Mapping[str, SensorBase]) -> None:
    """Register the structs of a scene's sensors."""
    for name, sensor in sensors.items():
        if sensor.struct is not None:
            resolver = structs.named(struct_of(sensor.struct), lambda kind: SensorStructs(kind, sensors))
            resolver.add(name, sensor.struct, sensor.counts)
