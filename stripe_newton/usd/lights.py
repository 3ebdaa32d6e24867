# SPDX-License-Identifier: Apache-2.0
"""What the renderer knows of a stage's lights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Light"]


@dataclass
class Light:
    """A light at infinity, in the frame of the simulation (Z up)."""

    kind: Literal["distant", "dome"]
    """``distant`` is the sun, ``dome`` the sky."""

    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear RGB; a colour temperature is already in it."""

    intensity: float = 1.0
    """UsdLux luminance in nits; the exposure is already in it."""

    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    """Unit vector the light travels along, world frame. Distant lights only."""

    path: str = ""
    """Prim it was read from; empty for a light that was made in code."""
