# SPDX-License-Identifier: Apache-2.0
"""What a ray caster is."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from .patterns import PatternBaseCfg
from .prims import OffsetCfg as FrameOffsetCfg
from .sensor_base import SensorBaseCfg

__all__ = ["RayCasterCfg"]


def _ray_caster(cfg: RayCasterCfg) -> Any:
    from .ray_caster import RayCaster

    return RayCaster(cfg)


@configclass
class RayCasterCfg(SensorBaseCfg):
    """Rays from a body to the ground or to any collider; with a :class:`GridPatternCfg` a height scanner."""

    @configclass
    class OffsetCfg(FrameOffsetCfg):
        """Pose of the sensor in the frame of its body; a height scanner stands well above all ground."""

    class_type: Callable[..., Any] | None = _ray_caster
    """Class that the scene makes of this config."""
    offset: OffsetCfg = OffsetCfg()
    """Pose of the sensor in the frame of its body."""
    pattern_cfg: PatternBaseCfg = MISSING
    """The rays, such as :class:`GridPatternCfg`."""
    ray_alignment: str = "base"
    """What the rays follow: ``"base"`` the body, ``"yaw"`` its heading alone, so that they stay upright, ``"world"``
    its position alone."""
    attach_yaw_only: bool | None = None
    """Former spelling: True is ``ray_alignment="yaw"``."""
    max_distance: float = 1.0e6
    """Length of the rays [m]; what is farther is not hit."""
    mesh_prim_paths: Sequence[str] = ()
    """Prims that the rays hit, with all below them, such as ``/World/ground`` or ``{ENV_REGEX_NS}/Box_.*``; expressions
    are allowed. Empty for every collider. Visuals that collide with nothing are never hit."""
    exclude_own: bool = True
    """Let the rays pass through the asset that carries the sensor."""
    drift_range: tuple[float, float] = (0.0, 0.0)
    """Bounds of an error of the body's position along x, y and z, drawn for each episode [m]."""
    ray_cast_drift_range: Mapping[str, tuple[float, float]] = {}
    """Bounds of a shift of the rays along their own ``x`` and ``y``, and of the hits along ``z``, drawn for each
    episode [m]."""
    noise: NoiseCfg | NoiseModelCfg | None = None
    """Noise of the lengths of the rays [m]; what hit nothing stays so. A noise model draws its bias for an episode."""
    delay: int = 0
    """How many measurements old pose and hits are."""

    @property
    def alignment(self) -> str:
        """:attr:`ray_alignment`, with the former spelling taken into account."""
        return "yaw" if self.attach_yaw_only else self.ray_alignment

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.ray_alignment not in ("base", "yaw", "world"):
            yield "ray_alignment", f"is {self.ray_alignment!r}, must be 'base', 'yaw' or 'world'"
        if not self.max_distance > 0.0:
            yield "max_distance", f"is {self.max_distance}, must be a distance above 0 [m]"
        if isinstance(self.mesh_prim_paths, str):
            yield "mesh_prim_paths", f"is {self.mesh_prim_paths!r}, must be a sequence: [{self.mesh_prim_paths!r}]"
        else:
            for i, path in enumerate(self.mesh_prim_paths):
                try:
                    re.compile(path)
                except re.error as error:
                    yield f"mesh_prim_paths[{i}]", f"is {path!r}, which is no regular expression: {error}"
        wrong = set(self.ray_cast_drift_range) - {"x", "y", "z"}
        if wrong:
            yield "ray_cast_drift_range", f"has {', '.join(sorted(wrong))}, its keys are x, y and z"
        for name, bounds in (("drift_range", self.drift_range), *self.ray_cast_drift_range.items()):
            if len(bounds) != 2 or not all(math.isfinite(b) for b in bounds):
                yield name, f"is {bounds}, must be two finite lengths [m]"
        if not isinstance(self.delay, int) or self.delay < 0:
            yield "delay", f"is {self.delay!r}, must be a whole number of measurements, 0 or more"
        if self.history_length:
            yield "history_length", "is not kept by ray casters; set it on the observation term"
