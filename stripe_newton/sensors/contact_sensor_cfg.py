# SPDX-License-Identifier: Apache-2.0
"""Config of the contact sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from stripe_newton.configclass import configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from .contact_sensor import ContactSensor
from .sensor_base import SensorBaseCfg

__all__ = ["ContactSensorCfg"]


@configclass
class ContactSensorCfg(SensorBaseCfg):
    """Contact forces on bodies; ``prim_path`` names the bodies."""

    class_type: Callable[..., Any] | None = ContactSensor
    filter_prim_paths_expr: Sequence[str] = ()
    """What the forces in ``force_matrix_w`` come from: bodies, or prims with all colliders below them, such as
    ``/World/ground`` or ``{ENV_REGEX_NS}/Ball``. Each that matches is one filter."""
    track_air_time: bool = False
    """Whether times in the air and in contact are kept."""
    track_pose: bool = False
    """Whether ``pos_w`` and ``quat_w`` are handed out."""
    force_threshold: float = 1.0
    """Force above which a body is in contact [N]."""
    substeps: bool | None = None
    """Measure after every physics step, so that the history holds physics steps and times are as fine; otherwise once,
    at the end of the environment's step. By default where a history is kept, or ``update_period`` is a physics step."""

    noise: NoiseCfg | NoiseModelCfg | None = None
    """Noise on ``net_forces_w`` and its history; times and ``force_matrix_w`` have none. A noise model draws its bias
    at the start of an episode."""
    delay: int = 0
    """How many measurements old ``net_forces_w`` and its history are; times and ``force_matrix_w`` are not late."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if not (math.isfinite(self.force_threshold) and self.force_threshold >= 0.0):
            yield "force_threshold", f"is {self.force_threshold}, must be a force, 0 or more [N]"
        if not isinstance(self.delay, int) or self.delay < 0:
            yield "delay", f"is {self.delay!r}, must be a whole number of measurements, 0 or more"
        if isinstance(self.filter_prim_paths_expr, str):
            yield "filter_prim_paths_expr", f"is the text '{self.filter_prim_paths_expr}', must be a list of paths"
