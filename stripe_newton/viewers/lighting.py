# SPDX-License-Identifier: Apache-2.0
"""Lighting of a picture: one sun, ambient light from sky and ground, and exposure, from the lights of a scene.

Stages have intensities in nits that suit a path tracer with automatic exposure (a dome of 2000, a distant light of
3000). Here only their ratio matters: the exposure makes ground in full light equally bright for all absolute
intensities, except that a brighter scene still looks slightly brighter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stripe_newton.usd import Light

__all__ = ["Lighting", "lighting_from"]

_REFERENCE = {"distant": 3000.0, "dome": 2000.0}
"""Usual intensity of each kind of light [nit]."""
_SUN_BESIDE_CAMERA = math.radians(-75.0)
_SUN_HEIGHT = math.radians(54.0)
_SUN_COLOR = (1.0, 0.955, 0.88)
_SKY_COLOR = (0.80, 0.90, 1.0)
_HORIZON = (0.54, 0.68, 0.81)
_ZENITH = (0.07, 0.20, 0.46)


@dataclass(frozen=True)
class Lighting:
    """Lighting of a picture. Colours are linear RGB.

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


def lighting_from(lights: Sequence[Light], azimuth: float = 0.0) -> Lighting:
    """Lighting of a picture from the lights of a scene.

    The strongest distant light is the sun; domes and the other distant lights add to the ambient light. Without a
    distant light, a weaker sun replaces it so that shapes keep their form. Without a dome, the sun adds some sky.

    Args:
        lights: The scene's lights.
        azimuth: Direction of the camera, about +Z from +X [rad]; a sun that the scene lacks shines from its left.
    """
    # Lights without intensity are as good as none: a sun must replace them.
    distant = sorted((x for x in lights if x.kind == "distant" and x.intensity > 0), key=lambda x: -x.intensity)
    domes = [x for x in lights if x.kind == "dome" and x.intensity > 0]
    sun, sky, tint = _sun_and_sky(distant, domes)
    sun, sky = 1.75 * sun, 0.62 * sky
    direction = np.asarray(distant[0].direction if distant else _default_direction(azimuth), dtype=float)
    length = float(np.linalg.norm(direction))
    to_sun = -direction / length if length > 0 else np.array([0.0, 0.0, 1.0])
    # Light on level ground; a low sun counts as one at about 12 degrees, or the exposure would rise without bound.
    level = float((sun * max(to_sun[2], 0.2) + sky).mean())
    # The exponent: a scene a hundred times as bright looks less than twice as bright.
    brightness = max(level, 1e-3) ** 0.12
    exposure = 1.0 / max(level, 1e-9) * brightness
    sun, sky = sun * exposure, sky * exposure
    backdrop = (0.35 + 0.65 * tint) * min(brightness, 1.3)
    return Lighting(
        to_sun=to_sun,
        sun=sun,
        sky=sky,
        # Light that the ground reflects upwards, a little warmer than what falls on it.
        ground=(0.42 * sky + 0.10 * sun) * np.array([1.0, 0.97, 0.93]),
        horizon=np.array(_HORIZON) * backdrop,
        zenith=np.array(_ZENITH) * backdrop,
    )


def _sun_and_sky(distant: Sequence[Light], domes: Sequence[Light]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radiance of the sun and of the sky, and the tint of the domes.

    Args:
        distant: Distant lights, the strongest first.
        domes: Dome lights.
    """
    sun = _radiance(distant[0]) if distant else np.zeros(3)
    sky = sum((_radiance(x) for x in domes), np.zeros(3)) + 0.5 * sum((_radiance(x) for x in distant[1:]), np.zeros(3))
    tint = sky / max(float(sky.max()), 1e-9) if domes else np.ones(3)
    if not distant and not domes:
        return np.array(_SUN_COLOR), np.array(_SKY_COLOR), tint
    if not distant:
        return 0.75 * float(sky.max()) * np.array(_SUN_COLOR) * tint, sky, tint
    if not domes:
        return sun, sky + 0.6 * float(sun.max()) * np.array(_SKY_COLOR), tint
    return sun, sky, tint


def _default_direction(azimuth: float) -> tuple[float, float, float]:
    """Direction of a sun that shines from the left of a camera."""
    at, flat = azimuth + _SUN_BESIDE_CAMERA, math.cos(_SUN_HEIGHT)
    return (-flat * math.cos(at), -flat * math.sin(at), -math.sin(_SUN_HEIGHT))


def _radiance(light: Light) -> np.ndarray:
    """Colour times intensity, as a multiple of the usual intensity of its kind."""
    if not math.isfinite(light.intensity):
        raise ValueError(f"a {light.kind} light has intensity {light.intensity}; expected a finite number of nits")
    return np.asarray(light.color, dtype=float) * light.intensity / _REFERENCE.get(light.kind, 3000.0)
