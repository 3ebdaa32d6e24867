# SPDX-License-Identifier: Apache-2.0
"""Config of the IMU."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

from stripe_newton.configclass import configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from . import prims
from .imu import NOISY_OUTPUTS, Imu
from .outputs import output_problems
from .sensor_base import SensorBaseCfg

__all__ = ["ImuCfg"]


@configclass
class ImuCfg(SensorBaseCfg):
    """An IMU on a body; ``prim_path`` names the body, or a site on it."""

    OffsetCfg: ClassVar[type] = prims.OffsetCfg

    class_type: Callable[..., Any] | None = Imu
    offset: prims.OffsetCfg = prims.OffsetCfg()
    """The IMU's frame relative to that of the body or site."""
    gravity_bias: tuple[float, float, float] = (0.0, 0.0, 9.81)
    """What is added to the acceleration, in the world frame [m/s^2]: an accelerometer at rest reads the reaction to
    gravity. Zeros give the acceleration alone."""
    substeps: bool = True
    """Accelerations over the last physics step, as an accelerometer reads them, at a launch for each physics step.
    Otherwise they are means over the environment's step, at one launch."""
    noise: Mapping[str, NoiseCfg | NoiseModelCfg] = {}
    """Noise by output, such as ``{"ang_vel_b": GaussianNoiseCfg(std=0.02)}``; a noise model draws its bias at the start
    of an episode."""
    delay: int = 0
    """How many measurements old all outputs are."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        yield from output_problems(self, NOISY_OUTPUTS, "an IMU")
