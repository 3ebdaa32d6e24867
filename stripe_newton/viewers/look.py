# SPDX-License-Identifier: Apache-2.0
"""Look: light and air of a picture as the kernels take them. Videos, previews and camera sensors begin with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import warp as wp

from stripe_kernels.picture_light import Look

if TYPE_CHECKING:
    from .lighting import Lighting

__all__ = ["lit_look"]

_CLOSEST_FOG = 6.0
"""Distance to what is looked at from which fog counts [m]: nearer things have the fog of this distance."""
_FOG_START, _FOG_LENGTH = 1.2, 9.0
"""Where fog begins and how deep it is, as multiples of the distance to what is looked at."""


def lit_look(lighting: Lighting, reach: float = _CLOSEST_FOG, fog: float = 1.0) -> Look:
    """Light and fog of a picture, without camera, haze and shadow map.

    Args:
        lighting: Sun, sky and ground.
        reach: Distance to what is looked at [m]; fog begins behind it.
        fog: Strength of the fog, 0 for none.
    """
    look = Look()
    for name in ("to_sun", "sun", "sky", "ground", "horizon", "zenith"):
        setattr(look, name, wp.vec3f(*getattr(lighting, name)))
    look.fog_start = _FOG_START * max(reach, _CLOSEST_FOG)
    look.fog_length = _FOG_LENGTH * max(reach, _CLOSEST_FOG) / fog if fog > 0.0 else 0.0
    look.exposure = look.air = look.tile = 1.0
    return look
