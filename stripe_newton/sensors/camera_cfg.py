# SPDX-License-Identifier: Apache-2.0
"""What a camera is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from .pinhole import PinholeIntrinsics
from .prims import OffsetCfg as FrameOffsetCfg
from .sensor_base import SensorBaseCfg

__all__ = ["DATA_TYPES", "CameraCfg", "PinholeCameraCfg", "TiledCameraCfg"]

DATA_TYPES = {
    "rgb": "rgb",
    "rgba": "rgb",
    "depth": "distance_to_image_plane",
    "distance_to_image_plane": "distance_to_image_plane",
    "distance_to_camera": "distance_to_camera",
    "normals": "normals",
    "semantic_segmentation": "semantic_segmentation",
    "instance_segmentation": "instance_segmentation",
    "instance_segmentation_fast": "instance_segmentation",
    "instance_id_segmentation": "instance_id_segmentation",
    "instance_id_segmentation_fast": "instance_id_segmentation",
}
"""What may be asked for, and the field of ``CameraData`` that holds it."""
_MOST_PIXELS = 2**31 - 1


@configclass
class PinholeCameraCfg(PinholeIntrinsics):
    """Lens, film, and the depths that are seen. Everything is in focus."""

    clipping_range: tuple[float, float] = (0.01, 1.0e3)
    """Depths along the optical axis between which things are seen [m]."""
    focus_distance: float = 400.0
    """Accepted for compatibility."""
    f_stop: float = 0.0
    """Accepted for compatibility."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        bounds = self.clipping_range
        if len(bounds) != 2 or not 0.0 <= bounds[0] < bounds[1] or not math.isfinite(bounds[1]):
            yield "clipping_range", f"is {bounds}, must be (near, far) with 0 <= near < far, both finite [m]"


def _camera(cfg: CameraCfg) -> Any:
    from .camera import Camera

    return Camera(cfg)


@configclass
class CameraCfg(SensorBaseCfg):
    """A pinhole camera in every environment, rendered for all of them at once by Newton's camera sensor.

    ``prim_path`` names a body, or a name of the camera's own below a body or below the environment, such as
    ``{ENV_REGEX_NS}/Robot/head/camera`` or ``{ENV_REGEX_NS}/Camera``.
    """

    @configclass
    class OffsetCfg(FrameOffsetCfg):
        """Pose of the camera in the frame of its body, or of the environment."""

        convention: str = "ros"
        """Which frame ``rot`` turns: ``"ros"`` looks along z with y down, ``"opengl"`` along -z with y up,
        ``"world"`` along x with z up."""

        def problems(self) -> Iterator[tuple[str, str]]:
            yield from super().problems()
            if self.convention not in ("ros", "opengl", "world"):
                yield "convention", f"is {self.convention!r}, must be 'ros', 'opengl' or 'world'"

    class_type: Callable[..., Any] | None = _camera
    """Class that the scene makes of this config."""
    offset: OffsetCfg = OffsetCfg()
    """Pose of the camera in the frame of its body, or of the environment."""
    spawn: PinholeCameraCfg = PinholeCameraCfg()
    """Lens and film."""
    width: int = MISSING
    """Pixels in a row."""
    height: int = MISSING
    """Pixels in a column."""
    data_types: Sequence[str] = ("rgb",)
    """What is rendered, of :data:`DATA_TYPES`."""
    depth_clipping_behavior: str = "none"
    """Depth of what is not seen: ``"none"`` infinity, ``"max"`` the far bound, ``"zero"`` 0."""
    background_color: tuple[float, float, float] = (0.66, 0.77, 0.88)
    """Colour where there is nothing, sRGB, each from 0 to 1."""
    shadows: bool = False
    """Whether the sun casts shadows: a second ray a pixel."""
    noise: NoiseCfg | NoiseModelCfg | None = None
    """Noise of depths and distances [m]; of colours, put it on the observations. What is not seen stays so."""
    delay: int = 0
    """How many pictures old pose and pictures are."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        for name in ("width", "height"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                yield name, f"is {value!r}, must be a whole number of pixels above 0"
        wrong = [t for t in self.data_types if t not in DATA_TYPES]
        if wrong or not self.data_types:
            yield "data_types", f"has {', '.join(map(repr, wrong)) or 'none'}, must be of {', '.join(DATA_TYPES)}"
        if self.depth_clipping_behavior not in ("none", "max", "zero"):
            yield "depth_clipping_behavior", f"is {self.depth_clipping_behavior!r}, must be 'none', 'max' or 'zero'"
        if len(self.background_color) != 3 or not all(0.0 <= c <= 1.0 for c in self.background_color):
            yield "background_color", f"is {self.background_color}, must be three numbers from 0 to 1"
        if not isinstance(self.delay, int) or self.delay < 0:
            yield "delay", f"is {self.delay!r}, must be a whole number of pictures, 0 or more"
        if self.history_length:
            yield "history_length", "is not kept by cameras"


@configclass
class TiledCameraCfg(CameraCfg):
    """The same; every camera is rendered for all environments at once."""
