# SPDX-License-Identifier: Apache-2.0
"""From a scene's lights to what the shading needs: one sun, an ambient light from sky and ground, an exposure.

Stages carry intensities in nits that suit a path tracer with automatic exposure (a dome of 2000, a distant light
of 3000). What counts here is their ratio: the picture is exposed so that ground in full light is equally bright
whatever the absolute figures, up to a mild change that still lets a brighter scene look brighter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["Lighting", "lighting_from"]

_REFERENCE = {"distant": 3000.0, "dome": 2000.0}
_SUN_BESIDE_CAMERA = math.radians(-75.0)
_SUN_HEIGHT = math.radians(54.0)
_SUN_COLOR = (1.0, 0.955, 0.88)
_SKY_COLOR = (0.80, 0.90, 1.0)
_HORIZON = (0.54, 0.68, 0.81)
_ZENITH = (0.07, 0.20, 0.46)


@dataclass(frozen=True)
class Lighting:
    """Light of a picture. Colours are linear RGB.

    Attributes:
        to_sun: Unit vector towards the sun, world frame.
        sun: Radiance of the sun.
        sky: Ambient radiance from above.
        ground: Ambient radiance from below.
        horizon: Colour of the sky at the horizon, and of the fog.
        zenith: Colour of the sky overhead.
    """

    to_sun: np.ndarray
    sun: np.ndarray
    sky: np.ndarray
    ground: np.ndarray
    horizon: np.ndarray
    zenith: np.ndarray


def lighting_from(lights: Sequence[Any], azimuth: float = 0.0) -> Lighting:
    """The lighting that ``lights`` (objects with ``kind, color, intensity, direction``) ask for.

    The strongest distant light is the sun; domes and the other distant lights add to the ambient light. Without a
    distant light a weaker sun stands in, so that shapes keep their form; without a dome the sun brings some sky.

    Args:
        lights: The scene's lights.
        azimuth: Where the camera stands, about +Z from +X [rad]; a sun that stands in shines from its left.
    """
    distant = sorted((x for x in lights if x.kind == "distant" and x.intensity > 0), key=lambda x: -x.intensity)
    domes = [x for x in lights if x.kind == "dome" and x.intensity > 0]
    sun = _radiance(distant[0]) if distant else np.zeros(3)
    sky = sum((_radiance(x) for x in domes), np.zeros(3)) + 0.5 * sum((_radiance(x) for x in distant[1:]), np.zeros(3))
    direction = np.asarray(distant[0].direction if distant else _default_direction(azimuth), dtype=float)
    tint = np.ones(3)
    if domes:
        tint = sky / max(float(sky.max()), 1e-9)
    if not distant and not domes:
        sun, sky = np.array(_SUN_COLOR), np.array(_SKY_COLOR)
    elif not distant:
        sun = 0.75 * float(sky.max()) * np.array(_SUN_COLOR) * tint
    elif not domes:
        sky = sky + 0.6 * float(sun.max()) * np.array(_SKY_COLOR)
    sun, sky = 1.75 * sun, 0.62 * sky
    length = float(np.linalg.norm(direction))
    to_sun = -direction / length if length > 0 else np.array([0.0, 0.0, 1.0])
    level = float((sun * max(to_sun[2], 0.2) + sky).mean())
    exposure = 1.0 / max(level, 1e-9) * max(level, 1e-3) ** 0.12
    sun, sky = sun * exposure, sky * exposure
    backdrop = (0.35 + 0.65 * tint) * min(max(level, 1e-3) ** 0.12, 1.3)
    return Lighting(
        to_sun=to_sun,
        sun=sun,
        sky=sky,
        ground=(0.42 * sky + 0.10 * sun) * np.array([1.0, 0.97, 0.93]),
        horizon=np.array(_HORIZON) * backdrop,
        zenith=np.array(_ZENITH) * backdrop,
    )


def _default_direction(azimuth: float) -> tuple[float, float, float]:
    at, flat = azimuth + _SUN_BESIDE_CAMERA, math.cos(_SUN_HEIGHT)
    return (-flat * math.cos(at), -flat * math.sin(at), -math.sin(_SUN_HEIGHT))


def _radiance(light: Any) -> np.ndarray:
    """Colour times intensity, as a multiple of what is usual for the kind of light."""
    if not math.isfinite(light.intensity):
        raise ValueError(f"a {light.kind} light has intensity {light.intensity}; expected a finite number of nits")
    return np.asarray(light.color, dtype=float) * light.intensity / _REFERENCE.get(light.kind, 3000.0)
