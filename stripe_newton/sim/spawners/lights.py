# SPDX-License-Identifier: Apache-2.0
"""Light spawners: lights as UsdLux prims. The renderer uses dome and distant lights."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated, ClassVar

from pxr import Gf, Usd, UsdLux

from stripe_newton.configclass import configclass
from stripe_newton.sim.scene_context import authored_path, current_stage
from stripe_newton.value_types import NonNegativeFloat, PositiveFloat, Range

from .spawner_cfg import Orientation, SpawnerCfg, Translation, finish, place

__all__ = [
    "CylinderLightCfg",
    "DiskLightCfg",
    "DistantLightCfg",
    "DomeLightCfg",
    "LightCfg",
    "SphereLightCfg",
    "spawn_light",
]


_LIGHTS = UsdLux.BoundableLightBase, UsdLux.NonboundableLightBase


def spawn_light(
    prim_path: str, cfg: LightCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author a UsdLux light of the kind that ``cfg`` names."""
    # UsdLux has a class for each type, all with the inputs of LightAPI.
    light = getattr(UsdLux, cfg.prim_type).Define(current_stage(), authored_path(prim_path))
    light.CreateColorAttr(Gf.Vec3f(*cfg.color))
    light.CreateIntensityAttr(cfg.intensity)
    light.CreateExposureAttr(cfg.exposure)
    light.CreateNormalizeAttr(cfg.normalize)
    light.CreateEnableColorTemperatureAttr(cfg.enable_color_temperature)
    light.CreateColorTemperatureAttr(cfg.color_temperature)
    for name in cfg.sizes:
        getattr(light, f"Create{name.capitalize()}Attr")(getattr(cfg, name))
    if isinstance(cfg, DomeLightCfg) and cfg.texture_file is not None:
        light.CreateTextureFileAttr(cfg.texture_file)
        light.CreateTextureFormatAttr(cfg.texture_format)
    place(light.GetPrim(), translation, orientation)
    return finish(light.GetPrim(), cfg)


@configclass
class LightCfg(SpawnerCfg):
    """Base of the lights; see UsdLux.LightAPI for the meaning of the fields."""

    func: Callable[..., Usd.Prim] = spawn_light
    """Function that authors the light."""
    prim_type: str = "SphereLight"
    """UsdLux type."""
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: NonNegativeFloat = 1.0
    """Brightness [nit]."""
    exposure: Annotated[float, Range(at_least=-64.0, at_most=64.0)] = 0.0
    """Doublings of the brightness."""
    normalize: bool = False
    """Divide the power by the size of the light."""
    enable_color_temperature: bool = False
    """Use ``color_temperature``."""
    color_temperature: PositiveFloat = 6500.0
    """Colour of a black body [K]."""

    sizes: ClassVar[tuple[str, ...]] = ()
    """Fields that say how large a light is, named as the inputs of the UsdLux type."""

    def problems(self) -> Iterator[tuple[str, str]]:
        kind = getattr(UsdLux, self.prim_type, None)
        needed = ["Define", *(f"Create{name.capitalize()}Attr" for name in self.sizes)]
        if not (isinstance(kind, type) and issubclass(kind, _LIGHTS) and all(hasattr(kind, name) for name in needed)):
            has = f" with {' and '.join(self.sizes)}" if self.sizes else ""
            yield "prim_type", f"is {self.prim_type!r}, must be a light of UsdLux{has}: {type(self).prim_type!r}"


@configclass
class DomeLightCfg(LightCfg):
    """Light from the whole sky."""

    prim_type: str = "DomeLight"
    """UsdLux type."""
    texture_file: str | None = None
    """Environment map. It is kept in the stage; the renderer uses the colour alone."""
    texture_format: str = "automatic"
    """Layout of the map: ``"automatic"``, ``"latlong"``, ``"mirroredBall"``, ``"angular"`` or
    ``"cubeMapVerticalCross"``; kept in the stage with it."""
    visible_in_primary_ray: bool = True
    """Ignored: the dome only lights the scene; cameras show their ``background_color``, viewers a sky of their own."""

    IGNORED: ClassVar[dict[str, str]] = {
        "visible_in_primary_ray": "the dome only lights the scene; cameras show their background_color, viewers a sky"
    }


@configclass
class DistantLightCfg(LightCfg):
    """A sun: parallel light along the prim's -Z axis."""

    sizes: ClassVar[tuple[str, ...]] = ("angle",)

    prim_type: str = "DistantLight"
    """UsdLux type."""
    angle: float = 0.53
    """Angular size [deg]."""


@configclass
class SphereLightCfg(LightCfg):
    """A glowing sphere; kept in the stage."""

    sizes: ClassVar[tuple[str, ...]] = ("radius",)

    radius: NonNegativeFloat = 0.5
    """Radius [m]."""


@configclass
class DiskLightCfg(LightCfg):
    """A glowing disk facing -Z; kept in the stage."""

    sizes: ClassVar[tuple[str, ...]] = ("radius",)

    prim_type: str = "DiskLight"
    """UsdLux type."""
    radius: NonNegativeFloat = 0.5
    """Radius [m]."""


@configclass
class CylinderLightCfg(LightCfg):
    """A glowing tube along X; kept in the stage."""

    sizes: ClassVar[tuple[str, ...]] = ("radius", "length")

    prim_type: str = "CylinderLight"
    """UsdLux type."""
    radius: NonNegativeFloat = 0.5
    """Radius [m]."""
    length: NonNegativeFloat = 1.0
    """Length [m]."""
