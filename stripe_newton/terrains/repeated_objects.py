# SPDX-License-Identifier: Apache-2.0
"""Repeated-object sub-terrains: boxes, cylinders or pyramids that lie on level ground around a platform."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt

from .sub_terrain import Range, SubTerrainBaseCfg
from .tile_geometry import axes, from_middle, lerp

__all__ = [
    "MeshRepeatedBoxesTerrainCfg",
    "MeshRepeatedCylindersTerrainCfg",
    "MeshRepeatedObjectsTerrainCfg",
    "MeshRepeatedPyramidsTerrainCfg",
    "repeated_objects_terrain",
]

_CLEARANCE = 0.1
"""Distance of objects from the platform, as a share of half the tile."""
_ROUND = 24
"""Sides of a cylinder."""


def repeated_objects_terrain(
    difficulty: float, cfg: MeshRepeatedObjectsTerrainCfg, rng: np.random.Generator
) -> np.ndarray:
    """Level ground with objects at random places and headings, and a platform in the middle.

    The surface of an object is exact, tilted objects included; what is below an overhang is filled.
    """
    start, end = cfg.object_params_start, cfg.object_params_end
    height = lerp((start.height, end.height), difficulty)
    platform = height if cfg.platform_height < 0.0 else cfg.platform_height
    x, y = axes(cfg)
    tile = np.where(from_middle(cfg) <= 0.5 * cfg.platform_width, 0.5 * platform, 0.0)
    for _ in range(start.num_objects + int(difficulty * (end.num_objects - start.num_objects))):
        at = _place(cfg, rng)
        tall = height * rng.uniform(*cfg.rel_height_noise) + rng.uniform(*cfg.abs_height_noise)
        turn = _turn(lerp((start.tilt, end.tilt), difficulty), rng)
        if tall > 0.0:
            normals, offsets = cfg.faces(difficulty, tall, rng)
            tile = np.maximum(tile, _top(x - at[0], y - at[1], normals @ turn.T, offsets))
    return tile


def _place(cfg: MeshRepeatedObjectsTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Middle of an object: anywhere but on the platform and close to it [m]."""
    size = np.array(cfg.size)
    free = 0.5 * cfg.platform_width + _CLEARANCE * 0.5 * size
    while True:
        at = rng.uniform(0.0, size)
        if (np.abs(at - 0.5 * size) > free).any():
            return at


def _turn(tilt: float, rng: np.random.Generator) -> np.ndarray:
    """Rotation matrix of a random heading and of angles about y and x of at most ``tilt`` [rad]."""
    from scipy.spatial.transform import Rotation  # here, as it takes long to import

    angles = rng.uniform(-math.pi, math.pi), *rng.uniform(-tilt, tilt, 2)
    return np.asarray(Rotation.from_euler("zyx", angles).as_matrix())


def _top(x: np.ndarray, y: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Height of a convex body over each point, 0 beside it; the body has ``normals @ p <= offsets``."""
    shape = np.broadcast_shapes(x.shape, y.shape)
    top, bottom = np.full(shape, np.inf), np.full(shape, -np.inf)
    inside = np.ones(shape, dtype=bool)
    for normal, offset in zip(normals, offsets, strict=True):
        left = offset - normal[0] * x - normal[1] * y
        if abs(normal[2]) < 1.0e-9:
            inside &= left >= 0.0
        elif normal[2] > 0.0:
            top = np.minimum(top, left / normal[2])
        else:
            bottom = np.maximum(bottom, left / normal[2])
    return np.where(inside & (top >= bottom), np.maximum(top, 0.0), 0.0)


@configclass
class MeshRepeatedObjectsTerrainCfg(SubTerrainBaseCfg):
    """Base of the kinds whose ground has many objects; a subclass says by :meth:`faces` what an object is."""

    @configclass
    class ObjectCfg:
        """Number and size of the objects."""

        num_objects: NonNegativeInt = MISSING
        """Number of objects on a tile."""
        height: NonNegativeFloat = MISSING
        """Height of an object [m]; half of a box or a cylinder is below the ground, a pyramid stands on it."""
        max_yx_angle: NonNegativeFloat = 0.0
        """Largest angle by which an object is turned about y and about x."""
        degrees: bool = True
        """Whether that angle is in degrees rather than in radians."""

        @property
        def tilt(self) -> float:
            """Largest angle about y and about x [rad]."""
            return math.radians(self.max_yx_angle) if self.degrees else self.max_yx_angle

    function: Callable[..., np.ndarray] = repeated_objects_terrain
    """Function that computes the heights."""
    object_params_start: ObjectCfg = MISSING
    """Objects at difficulty 0."""
    object_params_end: ObjectCfg = MISSING
    """Objects at difficulty 1."""
    abs_height_noise: Range = (0.0, 0.0)
    """Bounds of what is added to the height of each object [m]."""
    rel_height_noise: Range = (1.0, 1.0)
    """Bounds of a factor of the height of each object."""
    platform_width: NonNegativeFloat = 1.0
    """Side of the platform in the middle [m]."""
    platform_height: float = -1.0
    """Twice the height of the platform above the ground [m]; a negative one is the height of the objects."""

    def faces(self, difficulty: float, height: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Faces of an object about its middle: outward normals, shape ``(n, 3)``, and distances [m], shape ``(n,)``."""
        raise NotImplementedError(f"{type(self).__name__} does not say what its objects are")

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        for name in ("abs_height_noise", "rel_height_noise"):
            low, high = getattr(self, name)
            if not low <= high:
                yield name, f"is {(low, high)}, must be (least, most)"


@configclass
class MeshRepeatedBoxesTerrainCfg(MeshRepeatedObjectsTerrainCfg):
    """Boxes on level ground."""

    @configclass
    class ObjectCfg(MeshRepeatedObjectsTerrainCfg.ObjectCfg):
        """Number and size of the boxes."""

        size: tuple[float, float] = MISSING
        """Length and width of a box [m]."""

    object_params_start: ObjectCfg = MISSING
    """Boxes at difficulty 0."""
    object_params_end: ObjectCfg = MISSING
    """Boxes at difficulty 1."""

    def faces(self, difficulty: float, height: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        sides = zip(self.object_params_start.size, self.object_params_end.size, strict=True)
        half = 0.5 * np.array([*(lerp(pair, difficulty) for pair in sides), height])
        return np.concatenate([np.eye(3), -np.eye(3)]), np.concatenate([half, half])


@configclass
class MeshRepeatedCylindersTerrainCfg(MeshRepeatedObjectsTerrainCfg):
    """Cylinders on level ground."""

    @configclass
    class ObjectCfg(MeshRepeatedObjectsTerrainCfg.ObjectCfg):
        """Number and size of the cylinders."""

        radius: NonNegativeFloat = MISSING
        """Radius of a cylinder [m]."""

    object_params_start: ObjectCfg = MISSING
    """Cylinders at difficulty 0."""
    object_params_end: ObjectCfg = MISSING
    """Cylinders at difficulty 1."""

    def faces(self, difficulty: float, height: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        radius = lerp((self.object_params_start.radius, self.object_params_end.radius), difficulty)
        normals = [*_around(_ROUND), [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]
        return np.array(normals), np.array([radius] * _ROUND + [0.5 * height] * 2)


@configclass
class MeshRepeatedPyramidsTerrainCfg(MeshRepeatedObjectsTerrainCfg):
    """Pyramids of four or five sides on level ground."""

    @configclass
    class ObjectCfg(MeshRepeatedObjectsTerrainCfg.ObjectCfg):
        """Number and size of the pyramids."""

        radius: NonNegativeFloat = MISSING
        """Distance of the corners of a pyramid from its axis, where it meets the ground [m]."""

    object_params_start: ObjectCfg = MISSING
    """Pyramids at difficulty 0."""
    object_params_end: ObjectCfg = MISSING
    """Pyramids at difficulty 1."""

    def faces(self, difficulty: float, height: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        radius = lerp((self.object_params_start.radius, self.object_params_end.radius), difficulty)
        sides = int(rng.integers(4, 6))
        # A face goes from the middle of an edge of the base up to the tip, both in the plane of its normal.
        inner = max(radius * math.cos(math.pi / sides), 1.0e-9)
        flank = np.array([[height * x, height * y, inner] for x, y, _ in _around(sides)]) / math.hypot(height, inner)
        offset = height * inner / math.hypot(height, inner)
        return np.concatenate([flank, [[0.0, 0.0, -1.0]]]), np.array([offset] * sides + [0.0])


def _around(sides: int) -> list[list[float]]:
    """Unit vectors at equal angles about z."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    return [[float(np.cos(a)), float(np.sin(a)), 0.0] for a in angles]
