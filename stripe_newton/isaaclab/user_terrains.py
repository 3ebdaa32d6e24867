# SPDX-License-Identifier: Apache-2.0
"""Kinds of terrain that a user's files define: functions of Isaac Lab's signature, as heights of the package.

Isaac Lab's functions take ``(difficulty, cfg)`` and draw from ``numpy.random``. They return meshes and an origin, or,
below :func:`height_field_to_mesh`, whole numbers of ``vertical_scale``, rows along x.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import trimesh
import warp as wp

from stripe_kernels.rasterize import rasterize_from_above
from stripe_newton import terrains as native
from stripe_newton.configclass import configclass

__all__ = ["SubTerrainBaseCfg", "height_field_to_mesh", "heights_of_meshes", "make_border", "make_plane"]

_HALF_A_MILLIMETRE = 5.0e-4
_BOTTOM = -1.0e6


@contextmanager
def _numpy_seeded(rng: np.random.Generator) -> Iterator[None]:
    """Draws of ``numpy.random`` that follow from a generator, and its former state afterwards."""
    before = np.random.get_state()  # noqa: NPY002  # the state that a user's function draws from
    np.random.seed(int(rng.integers(2**32)))  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def height_field_to_mesh(func: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """Decorator of a user's height field: makes it a function of the package.

    The user's function returns whole numbers of ``cfg.vertical_scale``, shape ``(size[0] / horizontal_scale, size[1] /
    horizontal_scale)``, for the tile without its border.
    """

    @functools.wraps(func)
    def function(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
        step, border = cfg.horizontal_scale, int(cfg.border_width / cfg.horizontal_scale) + 1
        counts = [round(length / step) + 1 for length in cfg.size]
        inner = [count - 2 * border for count in counts]
        # A little more, as functions cut the quotient of both to a whole number.
        with _numpy_seeded(rng):
            found = func(difficulty, cfg.replace(size=tuple((count + 1e-6) * step for count in inner)))
        if found.shape != tuple(inner):
            name = getattr(func, "__name__", func)
            raise ValueError(f"'{name}' returned heights of shape {found.shape}, must be {tuple(inner)}, rows along x")
        heights = np.zeros(counts)
        heights[border:-border, border:-border] = found * cfg.vertical_scale
        return heights.T

    function.__signature__ = inspect.signature(_native)  # type: ignore[attr-defined]  # not that of `func`
    return function


def _native(difficulty: float, cfg: object, rng: np.random.Generator) -> np.ndarray:
    """The package's signature of the functions of terrains."""
    raise NotImplementedError


def heights_of_meshes(meshes: Sequence[trimesh.Trimesh], size: Sequence[float], horizontal_scale: float) -> np.ndarray:
    """Heights of the highest surface of meshes over a tile [m], rows along y; 0 where there is none.

    Args:
        meshes: Meshes in the tile's frame, whose corner is at x = y = 0.
        size: Size of the tile in x and y [m].
        horizontal_scale: Distance between the heights [m].
    """
    whole = trimesh.util.concatenate(list(meshes))
    points, faces = np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.int32)
    counts = [round(length / horizontal_scale) + 1 for length in size]
    # A ray exactly on an edge may miss the mesh: those of the tile's edge are moved inwards.
    x, y = (
        np.clip(np.arange(n) * horizontal_scale, _HALF_A_MILLIMETRE, length - _HALF_A_MILLIMETRE).astype(np.float32)
        for n, length in zip(counts, size, strict=True)
    )
    with wp.ScopedDevice("cpu"):
        surface = wp.Mesh(wp.array(points, dtype=wp.vec3), wp.array(faces.reshape(-1), dtype=int))
        heights, lost = (wp.zeros((counts[1], counts[0]), dtype=float) for _ in range(2))
        rows = [wp.array(values, dtype=float) for values in (x, y)]
        inputs = [surface.id, *rows, float(points[:, 2].max()) + 1.0, _BOTTOM]
        wp.launch(rasterize_from_above, dim=heights.shape, inputs=inputs, outputs=[heights, lost])
        found = heights.numpy()
    return np.where(found <= _BOTTOM, 0.0, found)


@configclass
class SubTerrainBaseCfg(native.SubTerrainBaseCfg):
    """Base of a user's kinds; ``function`` has the package's signature, or Isaac Lab's, which returns meshes."""

    def heights(self, difficulty: float, rng: np.random.Generator) -> np.ndarray:
        """Heights of a tile [m], rows along y."""
        if len(inspect.signature(self.function).parameters) != 2:
            return super().heights(difficulty, rng)
        with _numpy_seeded(rng):
            meshes = self.function(difficulty, self)[0]
        return heights_of_meshes(meshes, self.size, self.horizontal_scale)


# -- meshes that functions of users are made of


def make_plane(size: tuple[float, float], height: float, center_zero: bool = True) -> trimesh.Trimesh:
    """A level rectangle of a size [m]; its middle, or else its corner, is at x = y = 0."""
    x, y = size
    corners = np.array([[0.0, 0.0], [x, 0.0], [x, y], [0.0, y]]) - (0.5 * np.array(size) if center_zero else 0.0)
    return trimesh.Trimesh(np.column_stack([corners, np.full(4, height)]), [[0, 1, 2], [0, 2, 3]])


def make_border(
    size: tuple[float, float], inner_size: tuple[float, float], height: float, position: tuple[float, float, float]
) -> list[trimesh.Trimesh]:
    """Four boxes around a rectangular hole.

    Args:
        size: Outer size in x and y [m].
        inner_size: Size of the hole [m].
        height: Height of the boxes [m].
        position: Centre of the border [m].
    """
    across, along = ((outer - inner) / 2.0 for outer, inner in zip(size, inner_size, strict=True))
    side, end = (inner_size[0] + across) / 2.0, (inner_size[1] + along) / 2.0
    boxes = [((across, inner_size[1], height), (sign * side, 0.0, 0.0)) for sign in (-1.0, 1.0)]
    boxes += [((size[0], along, height), (0.0, sign * end, 0.0)) for sign in (1.0, -1.0)]
    place = trimesh.transformations.translation_matrix
    return [trimesh.creation.box(extent, place(np.add(position, shift))) for extent, shift in boxes]
