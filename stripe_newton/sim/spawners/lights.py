# SPDX-License-Identifier: Apache-2.0
"""Lights, authored as UsdLux prims. The renderer uses dome and distant lights."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from stripe_newton.configclass import configclass

from .spawner_cfg import Orientation, SpawnerCfg, Translation, finish, place

if TYPE_CHECKING:
    from pxr import Usd

__all__ = [
    "CylinderLightCfg",
    "DiskLightCfg",
    "DistantLightCfg",
    "DomeLightCfg",
    "LightCfg",
    "SphereLightCfg",
    "spawn_light",
]


def spawn_light(
    prim_path: str, cfg: LightCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author a UsdLux light of the kind that ``cfg`` names."""
    from pxr import Gf, UsdLux

    from stripe_newton.sim.stage import authored_path, current_stage

    light = getattr(UsdLux, cfg.prim_type).Define(current_stage(), authored_path(prim_path))
    light.CreateColorAttr(Gf.Vec3f(*cfg.color))
    light.CreateIntensityAttr(cfg.intensity)
    light.CreateExposureAttr(cfg.exposure)
    light.CreateNormalizeAttr(cfg.normalize)
    light.CreateEnableColorTemperatureAttr(cfg.enable_color_temperature)
    light.CreateColorTemperatureAttr(cfg.color_temperature)
    for name in ("angle", "radius", "length"):
        if hasattr(cfg, name):
            getattr(light, f"Create{name.capitalize()}Attr")(getattr(cfg, name))
    if isinstance(cfg, DomeLightCfg) and cfg.texture_file is not None:
        light.CreateTextureFileAttr(cfg.texture_file)
    place(light.GetPrim(), translation, orientation)
    return finish(light.GetPrim(), cfg)


@configclass
class LightCfg(SpawnerCfg):
    """Base of the lights; see UsdLux.LightAPI for the meaning of the fields."""

    func: Callable[..., Any] = spawn_light
    """Function that authors the light."""
    prim_type: str = "SphereLight"
    """UsdLux type."""
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: float = 1.0
    """Brightness [nit]."""
    exposure: float = 0.0
    """Doublings of the brightness."""
    normalize: bool = False
    """Divide the power by the size of the light."""
    enable_color_temperature: bool = False
    """Use ``color_temperature``."""
    color_temperature: float = 6500.0
    """Colour of a black body [K]."""


@configclass
class DomeLightCfg(LightCfg):
    """Light from the whole sky."""

    prim_type: str = "DomeLight"
    """UsdLux type."""
    texture_file: str | None = None
    """Environment map; kept in the stage, the renderer uses the colour alone."""
    texture_format: str = "automatic"
    """Accepted for compatibility; the map's own layout is used."""
    visible_in_primary_ray: bool = True
    """Accepted for compatibility."""


@configclass
class DistantLightCfg(LightCfg):
    """A sun: parallel light along the prim's -Z axis."""

    prim_type: str = "DistantLight"
    """UsdLux type."""
    angle: float = 0.53
    """Angular size [deg]."""


@configclass
class SphereLightCfg(LightCfg):
    """A glowing sphere; kept in the stage."""

    radius: float = 0.5
    """Radius [m]."""


@configclass
class DiskLightCfg(LightCfg):
    """A glowing disk facing -Z; kept in the stage."""

    prim_type: str = "DiskLight"
    """UsdLux type."""
    radius: float = 0.5
    """Radius [m]."""


@configclass
class CylinderLightCfg(LightCfg):
    """A glowing tube along X; kept in the stage."""

    prim_type: str = "CylinderLight"
    """UsdLux type."""
    radius: float = 0.5
    """Radius [m]."""
    length: float = 1.0
    """Length [m]."""
