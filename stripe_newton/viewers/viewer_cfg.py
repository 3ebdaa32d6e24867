# SPDX-License-Identifier: Apache-2.0
"""Viewer config: camera, size and style of the pictures of environments. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stripe_newton.configclass import configclass
from stripe_newton.value_types import NonNegativeInt, PositiveInt

__all__ = ["ORIGIN_TYPES", "ViewerCfg"]

ORIGIN_TYPES = ("world", "env", "asset_root", "asset_heading")
"""Possible values of ``origin_type``."""


@configclass
class ViewerCfg:
    """Camera and style of ``env.render()`` and of the videos that training and playing write."""

    eye: tuple[float, float, float] | None = None
    """Camera position [m], relative to ``origin_type``. None: automatic framing of the environment."""

    lookat: tuple[float, float, float] | None = None
    """Point in the middle of the picture [m], relative to ``origin_type``. None: the origin where ``eye`` is set."""

    origin_type: str = "env"
    """Frame of ``eye`` and ``lookat``: ``"world"``, ``"env"`` (the origin of environment ``env_index``),
    ``"asset_root"`` (the root body of ``asset_name`` in environment ``env_index``; the camera follows it without
    turning) or ``"asset_heading"`` (the camera also turns with it, and comes nearer where scenery hides it)."""

    asset_name: str | None = None
    """Asset that ``origin_type="asset_root"`` follows: a name in its prim path, such as ``"Robot"``, in any case.
    None: the first asset of the environment."""

    env_index: NonNegativeInt = 0
    """Environment to show, unless the caller names others."""

    num_shown: PositiveInt = 1
    """Environments to show, unless the caller names them: ``env_index`` and those whose origins are nearest to it."""

    resolution: tuple[int, int] | None = None
    """Width and height of the picture [px]; in videos, odd numbers are made even. None: 1280 x 720 on a GPU and
    640 x 360 on the CPU, where a pixel takes as long as there a hundred."""

    fov: float = 35.0
    """Vertical field of view [deg]."""

    azimuth: float | None = None
    """Automatic framing: direction from the scene to the camera, about +Z from +X [deg]. None: -55, or 25 from the
    perpendicular of the long side if the scene is long and thin."""

    elevation: float | None = None
    """Automatic framing: angle of the camera above the horizon [deg]. None: 13, or 40 where nothing moves and the scene
    is wide and low, as rooms are."""

    margin: float = 1.35
    """Automatic framing: size of the picture relative to the scene in it."""

    follow: bool = True
    """Automatic framing: move with robots that are not fixed to the ground, and back where a fixed one reaches out of
    the picture."""

    follow_time: float = 8.0
    """Number of frames over which the motion of the camera is smoothed; 0 follows rigidly."""

    anti_aliasing: bool = True
    """Smooth outlines: pixels on an edge are traced four more times, which takes about a quarter of a frame's time.
    Outdoors, only the outlines of robots are smoothed."""

    shadows: bool = True
    """Soft shadows of the sun."""

    shadow_resolution: int | None = None
    """Side of the shadow map [px], which is traced for every frame; a smaller map gives softer shadows. None: 1024 on a
    GPU, 256 on the CPU, and 384 there with several environments."""

    fog: float = 1.0
    """Strength of the fog that fades distant things into the horizon; 0 switches it off."""

    natural: bool | None = None
    """Draw static meshes as outdoors: all of them cast ray-traced shadows, with light through leaves, and haze; bark,
    rock and soil of generated scenery have grain, and what is made is plain. None: if the scene has 64 or more."""

    near: float = 0.0
    """Outdoors: scenery nearer to the camera is not drawn [m], so that no leaf in front of it hides everything."""

    haze: float = 0.004
    """Outdoors: share of the light that haze absorbs per metre [1/m]; it replaces ``fog``."""

    exposure: float = 1.0
    """Outdoors: factor on the exposure, which adapts to the picture."""

    floor: bool = False
    """Draw a floor that is not there, under a scene without anything static, if all that moves in it is held."""

    horizon: bool = True
    """Continue a terrain that is a height field to the horizon, where nothing touches it."""

    recolor: bool = True
    """Give shapes without a colour in the stage one of a small palette, by body."""

    @property
    def aim(self) -> tuple[float, float, float] | None:
        """Point in the middle of the picture [m], as ``lookat``; None for automatic framing."""
        return None if self.eye is None else self.lookat or (0.0, 0.0, 0.0)

    def size_on(self, is_gpu: bool) -> tuple[int, int]:
        """Width and height of a picture [px] that is drawn on a GPU or on the CPU."""
        width, height = self.resolution or ((1280, 720) if is_gpu else (640, 360))
        return int(width), int(height)

    def shadow_size_on(self, is_gpu: bool) -> int:
        """Side of the shadow map [px] of a picture that is drawn on a GPU or on the CPU."""
        default = 1024 if is_gpu else 384 if self.num_shown > 1 else 256
        return default if self.shadow_resolution is None else int(self.shadow_resolution)

    def problems(self) -> Iterator[tuple[str, str]]:
        """Pairs of a field and what is wrong with it, for :meth:`validate`."""
        yield from self._camera_problems()
        if self.resolution is not None and not _sizes(self.resolution):
            yield "resolution", f"got {self.resolution!r}, expected (width, height), whole numbers from 16 to 8192"
        if isinstance(self.env_index, bool) or not isinstance(self.env_index, int) or self.env_index < 0:
            yield "env_index", f"got {self.env_index!r}, expected the index of an environment, 0 or more"
        for name, low, high in _RANGES:
            value = getattr(self, name)
            if value is None and name in ("azimuth", "elevation", "shadow_resolution"):
                continue
            if not _numbers((value,), 1) or not low <= value <= high:
                yield name, f"got {value!r}, expected a number from {low:g} to {high:g}"

    def _camera_problems(self) -> Iterator[tuple[str, str]]:
        for name in ("eye", "lookat"):
            value = getattr(self, name)
            if value is not None and not _numbers(value, 3):
                yield name, f"got {value!r}, expected three numbers (x, y, z) in metres, or None"
        if self.eye is None and self.lookat is not None:
            yield "eye", "is None while lookat is set; give both, or neither for automatic framing"
        elif self.eye is not None and tuple(self.eye) == tuple(self.aim or ()):
            yield "lookat", f"is the same point as eye, {tuple(self.eye)}; the camera needs a direction"
        if self.origin_type not in ORIGIN_TYPES:
            yield "origin_type", f"got {self.origin_type!r}, expected one of {', '.join(map(repr, ORIGIN_TYPES))}"


_RANGES = (
    ("fov", 5.0, 120.0),
    ("azimuth", -360.0, 360.0),
    ("elevation", -80.0, 89.0),
    ("margin", 0.5, 10.0),
    ("follow_time", 0.0, 1000.0),
    ("shadow_resolution", 32, 4096),
    ("fog", 0.0, 100.0),
    ("near", 0.0, 1000.0),
    ("haze", 0.0, 1.0),
    ("exposure", 0.01, 100.0),
)


def _sizes(value: object) -> bool:
    """Whether a value is a picture's width and height."""
    if not isinstance(value, Sequence) or not _numbers(value, 2):
        return False
    return all(int(n) == n and 16 <= n <= 8192 for n in value)


def _numbers(value: object, count: int) -> bool:
    """Whether a value is a sequence of so many finite numbers."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
        return False
    return all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) < 1e9 for v in value)
