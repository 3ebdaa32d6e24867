# SPDX-License-Identifier: Apache-2.0
"""Lights of a stage: the dome and distant lights that the renderer uses, and the lights that it does not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pxr import Gf, Usd, UsdGeom, UsdLux

from .stage_access import open_stage, walk

__all__ = ["Light", "ignored_lights", "read_lights"]


@dataclass
class Light:
    """A light at infinity, in the simulation's frame (Z up)."""

    kind: Literal["distant", "dome"]
    """``distant`` is the sun, ``dome`` the sky."""

    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear RGB, with the colour temperature included."""

    intensity: float = 1.0
    """Luminance as in UsdLux [nit], with the exposure included."""

    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    """Unit vector along which the light travels, world frame. Distant lights only."""

    path: str = ""
    """Prim that it was read from; empty for a light made in code."""


def read_lights(source: str | Path | Usd.Stage, root_path: str = "/") -> list[Light]:
    """Read the visible dome and distant lights of a stage, in stage order.

    Intensity includes exposure (a factor of two per stop). Colour includes the colour temperature where it is enabled.
    Other kinds of light are not read: see :func:`ignored_lights`.
    """
    stage = open_stage(source)
    to_z_up = Gf.Rotation(Gf.Vec3d(0.0, 0.0, 1.0), 0.0)  # the default constructor leaves it undefined
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        to_z_up = Gf.Rotation(Gf.Vec3d(1, 0, 0), 90.0)
    lights = [prim for prim in walk(stage, root_path) if _is_rendered(prim) and _is_visible(prim)]
    return [_read_light(prim, to_z_up) for prim in lights if _is_finite(prim)]


def _read_light(prim: Usd.Prim, to_z_up: Gf.Rotation) -> Light:
    api = UsdLux.LightAPI(prim)
    color = Gf.Vec3f(api.GetColorAttr().Get())
    if api.GetEnableColorTemperatureAttr().Get():
        color = Gf.CompMult(color, UsdLux.BlackbodyTemperatureAsRgb(api.GetColorTemperatureAttr().Get()))
    world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    direction = to_z_up.TransformDir(world.TransformDir(Gf.Vec3d(0, 0, -1))).GetNormalized()
    return Light(
        kind="dome" if _is_dome(prim) else "distant",
        color=(float(color[0]), float(color[1]), float(color[2])),
        intensity=_intensity(prim),
        # UsdLux: a distant light shines along its prim's -z.
        direction=(float(direction[0]), float(direction[1]), float(direction[2])),
        path=str(prim.GetPath()),
    )


def ignored_lights(stage: Usd.Stage, root_path: str = "/") -> list[tuple[str, str, str]]:
    """``(path, what, why)`` of lights that :func:`read_lights` leaves out, and of dome textures."""
    rows = []
    for prim in walk(stage, root_path):
        if not prim.HasAPI(UsdLux.LightAPI) or prim.IsA(UsdLux.LightFilter):
            continue
        path, what = str(prim.GetPath()), prim.GetTypeName() or "light"
        if not _is_rendered(prim):
            rows.append((path, what, "only dome and distant lights are rendered"))
        elif not _is_visible(prim):
            rows.append((path, what, "invisible"))
        elif not _is_finite(prim):
            rows.append((path, what, "intensity and exposure give no finite brightness"))
        elif _is_dome(prim) and prim.GetAttribute("inputs:texture:file").Get():
            rows.append((path, "dome texture", "the dome is rendered in one colour"))
    return rows


def _is_rendered(prim: Usd.Prim) -> bool:
    return _is_dome(prim) or prim.IsA(UsdLux.DistantLight)


def _intensity(prim: Usd.Prim) -> float:
    """Brightness of a light with its exposure [nit], which may be infinite or not a number."""
    api = UsdLux.LightAPI(prim)
    exposure = float(api.GetExposureAttr().Get())
    # Within the doublings of a float, beyond which the power itself would be an error.
    return float(api.GetIntensityAttr().Get()) * 2.0 ** min(exposure, 1000.0)


def _is_finite(prim: Usd.Prim) -> bool:
    return abs(_intensity(prim)) < 1e38  # as the renderer computes in 32 bits


def _is_dome(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DomeLight_1)


def _is_visible(prim: Usd.Prim) -> bool:
    return UsdGeom.Imageable(prim).ComputeVisibility() != UsdGeom.Tokens.invisible
