# SPDX-License-Identifier: Apache-2.0
"""Picture parts: chooses the pixels of a frame that need rays, from the boxes around the shapes.

On the CPU a ray takes as long as hundreds of instructions, and most pixels show a ground plane or the sky, which need
none. Where camera and light stand still, a pixel that no moving shape and none of its shadow can reach stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import newton
import numpy as np

if TYPE_CHECKING:
    from .display_model import DisplayModel

__all__ = ["Part", "PictureParts", "View"]

_TILE = 4
"""Side of a tile [px]: parts are chosen by tiles."""
_MARGIN = 2.0
"""Pixels around a shape that are traced, too: those next to its edge are smoothed."""
_NEAR = 1.0e-3
"""Distance from the camera below which a corner of a box counts as behind it [m]."""
_BLUR = 6.0
"""Texels of the shadow map by which the soft edge of a shadow, and what shields a surface from its own, may reach."""
_SLICES = 8
"""Slices of a box."""
_MOST_SLICED = 500
"""Boxes up to which it saves time to cut them into slices."""
_BOXED = frozenset(
    int(kind)
    for kind in (
        newton.GeoType.SPHERE,
        newton.GeoType.CAPSULE,
        newton.GeoType.CYLINDER,
        newton.GeoType.CONE,
        newton.GeoType.BOX,
        newton.GeoType.ELLIPSOID,
        newton.GeoType.MESH,
        newton.GeoType.CONVEX_MESH,
    )
)
"""Types of shapes whose boxes are known."""


@dataclass
class Part:
    """Pixels and texels of a frame, indices into flat images.

    Attributes:
        pixels: Pixels that may have changed since the last frame.
        traced: Those of them that may show a shape with a box.
        plain: The others, which show a plane or the sky.
        texels: Texels of the shadow map in which a shape may be, or was.
        is_same_view: Whether all other pixels and texels stay as they are; otherwise other texels are empty.
    """

    pixels: np.ndarray
    traced: np.ndarray
    plain: np.ndarray
    texels: np.ndarray
    is_same_view: bool


@dataclass
class View:
    """Camera and shadow map of a frame.

    Attributes:
        eye: Position of the camera [m], shape (3,).
        axes: Its right, up and backward unit vectors, as columns (3, 3).
        tan: Half the width and height of the picture at distance 1.
        sun: Axes of the shadow map as columns (3, 3), the last one towards the sun.
        center: Centre of the shadow map [m], shape (3,).
        half: Half its side [m].
    """

    eye: np.ndarray
    axes: np.ndarray
    tan: tuple[float, float]
    sun: np.ndarray
    center: np.ndarray
    half: float

    def is_same(self, other: View) -> bool:
        """Whether both are of the same camera and the same shadow map, exactly."""
        if (self.tan, self.half) != (other.tan, other.half):
            return False
        mine, its = ((view.eye, view.axes, view.sun, view.center) for view in (self, other))
        return all(np.array_equal(a, b) for a, b in zip(mine, its, strict=True))


class PictureParts:
    """Chooses the pixels of each frame of a display model that need rays or shading.

    Args:
        scene: The display model, one that :meth:`serves` accepts.
        size: Width and height of the picture [px].
        shadow_size: Side of the shadow map [texels], 0 for none.
    """

    def __init__(self, scene: DisplayModel, size: tuple[int, int], shadow_size: int):
        self._scene, self._size, self._shadow_size = scene, size, shadow_size
        self.planes = np.array(_planes(scene), dtype=int)
        """The visible planes among the shapes."""
        self._heights = np.unique(scene.model.shape_transform.numpy()[self.planes, 2].astype(float))
        self._last: tuple[View, np.ndarray] | None = None

    @staticmethod
    def serves(scene: DisplayModel) -> bool:
        """Whether all that a display model shows are level planes without an end, and shapes whose boxes are known.

        Markers change their size from frame to frame, textures their colour from place to place.
        """
        if scene.textured or scene.has_markers or len(scene.scenery) or scene.model.particle_count:
            return False
        known = set(_planes(scene))
        visible = np.flatnonzero(scene.is_visible)
        return all(int(scene.kinds[i]) in _BOXED or int(i) in known for i in visible)

    def restart(self) -> None:
        """Make the next part the whole picture."""
        self._last = None

    def choose(self, view: View) -> Part:
        """The part of the next frame.

        Args:
            view: Its camera and shadow map.
        """
        boxes, before = _sliced(self._scene.corners()), self._last
        shown, is_same = self._tiles(view, boxes), before is not None and before[0].is_same(view)
        changed, cast = np.ones_like(shown), boxes
        if before is not None and is_same:
            moved = (boxes != before[1]).any(axis=(1, 2))  # NaN differs from itself: such a shape always moves
            cast = np.concatenate([boxes[moved], before[1][moved]])
            changed = self._changed(view, cast, boxes)
        self._last = view, boxes
        width, height = self._size
        pixels, traced, plain = (_pixels(t, width, height) for t in (changed, shown & changed, ~shown & changed))
        return Part(pixels, traced, plain, self._texels(view, cast), is_same)

    def _changed(self, view: View, moved: np.ndarray, boxes: np.ndarray) -> np.ndarray:
        """Tiles that boxes which moved, or their shadows, reach or have left; by their corners now and before."""
        tiles = self._tiles(view, moved)
        if self._shadow_size and len(moved):
            tiles |= self._tiles(view, boxes[self._may_be_shaded(view, moved, boxes)])
            around = _BLUR * 2.0 * view.half / self._shadow_size
            grown = _corners_of(np.concatenate([moved.min(axis=1) - around, moved.max(axis=1) + around], axis=1))
            for height in self._heights:
                down = np.maximum(grown[..., 2] - height, 0.0) / view.sun[2, 2]
                fallen = grown - down[..., None] * view.sun[:, 2]
                # Of a box that reaches through the plane, its own corners bound the shadow, too.
                through = (grown[..., 2].min(axis=1) < height)[:, None, None]
                tiles |= self._tiles(view, np.concatenate([fallen, np.where(through, grown, fallen)], axis=1))
        return tiles

    def _may_be_shaded(self, view: View, moved: np.ndarray, boxes: np.ndarray) -> np.ndarray:
        """Whether each box shares texels of the shadow map with one that moved, with the blur around."""
        low, high = self._texel_bounds(view, moved)
        there = np.isfinite(low).all(axis=1)
        size = self._shadow_size
        shaded = _cover(low[there] - _BLUR, high[there] + _BLUR, size, size, _TILE)
        sums = np.pad(shaded.astype(np.int32).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        low, high = self._texel_bounds(view, boxes)
        there = np.isfinite(low).all(axis=1)
        first, last = _tile_bounds(low[there], high[there], size, size, _TILE)
        (x0, y0), (x1, y1) = first.T, last.T
        there[there] = sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0] > 0
        return there

    def _tiles(self, view: View, corners: np.ndarray) -> np.ndarray:
        """Tiles that convex bodies with corners (n, m, 3) may cover, shape (rows, columns)."""
        width, height = self._size
        seen = (corners - view.eye) @ view.axes
        depth = -seen[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            column = 0.5 * width * (1.0 + seen[..., 0] / depth / view.tan[0])
            row = 0.5 * height * (1.0 - seen[..., 1] / depth / view.tan[1])
        low = np.stack([column.min(axis=1), row.min(axis=1)], axis=1) - _MARGIN
        high = np.stack([column.max(axis=1), row.max(axis=1)], axis=1) + _MARGIN
        # A body that reaches behind the camera may be anywhere in the picture; one all of which is behind is nowhere.
        partly = (depth < _NEAR).any(axis=1)
        low[partly], high[partly] = -np.inf, np.inf
        there = np.isfinite(corners).all(axis=(1, 2)) & (depth >= _NEAR).any(axis=1)
        return _cover(low[there], high[there], width, height, _TILE)

    def _texels(self, view: View, boxes: np.ndarray) -> np.ndarray:
        """Texels of the shadow map that boxes may cover."""
        size = self._shadow_size
        if not size:
            return np.zeros(0, dtype=np.int32)
        low, high = self._texel_bounds(view, boxes)
        there = np.isfinite(low).all(axis=1)
        return _pixels(_cover(low[there] - 1.0, high[there] + 1.0, size, size, _TILE), size, size)

    def _texel_bounds(self, view: View, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the rectangles around boxes in the shadow map [texels], each (n, 2); not finite for some."""
        local = (boxes - view.center) @ view.sun
        column = (local[..., 0] / view.half * 0.5 + 0.5) * self._shadow_size
        row = (0.5 - local[..., 1] / view.half * 0.5) * self._shadow_size
        at = np.stack([column, row], axis=-1)
        return at.min(axis=1), at.max(axis=1)


def _planes(scene: DisplayModel) -> list[int]:
    """Visible level planes without an end, on no body."""
    model = scene.model
    body, scale, pose = model.shape_body.numpy(), model.shape_scale.numpy(), model.shape_transform.numpy()
    level = 1.0 - 2.0 * (pose[:, 3] ** 2 + pose[:, 4] ** 2)  # the z component of the normal
    is_plane = scene.kinds == int(newton.GeoType.PLANE)
    endless = is_plane & scene.is_visible & (body < 0) & ~scale[:, :2].any(axis=1) & (level > 0.9999)
    return [int(i) for i in np.flatnonzero(endless)]


def _sliced(boxes: np.ndarray) -> np.ndarray:
    """Boxes, corners (n, 8, 3), cut into slices along their longest edges.

    The rectangle around a long box that lies across the picture is much larger than the box.
    """
    if len(boxes) > _MOST_SLICED:
        return boxes
    edges = np.linalg.norm(boxes[:, [1, 2, 4]] - boxes[:, :1], axis=2)  # not finite for boxes that stay so
    axis = np.where(np.isfinite(edges), edges, 0.0).argmax(axis=1)
    number = np.arange(8)
    # The ends of the edge through each corner, of which bit k of its number is its side along axis k.
    low, high = (np.take_along_axis(boxes, ends[..., None], axis=1) for ends in _ends(axis, number))
    side = ((number >> axis[:, None]) & 1)[..., None]
    shares = (side[None] + np.arange(_SLICES)[:, None, None, None]) / _SLICES
    return (low + shares * (high - low)).reshape(-1, 8, 3)


def _ends(axis: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners at both ends of the edges along an axis (n,) through corners (m,), each of shape (n, m)."""
    bit = 1 << axis[:, None]
    return number & ~bit, number | bit


def _corners_of(boxes: np.ndarray) -> np.ndarray:
    """Corners of boxes (n, 6), lower corner first, shape (n, 8, 3)."""
    pick = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)], dtype=bool)
    return np.where(pick[None], boxes[:, None, 3:], boxes[:, None, :3])


def _cover(low: np.ndarray, high: np.ndarray, width: int, height: int, tile: int) -> np.ndarray:
    """Tiles of a picture that rectangles touch, from corners (n, 2) [px], shape (rows, columns)."""
    first, last = _tile_bounds(low, high, width, height, tile)
    count = np.zeros((-(-height // tile) + 1, -(-width // tile) + 1), dtype=np.int32)
    # Each rectangle adds at its corners, so that sums along rows and columns count the rectangles over a tile.
    for columns, rows, sign in (
        (first[:, 0], first[:, 1], 1),
        (last[:, 0], first[:, 1], -1),
        (first[:, 0], last[:, 1], -1),
        (last[:, 0], last[:, 1], 1),
    ):
        np.add.at(count, (rows, columns), sign)
    return count.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0


def _tile_bounds(
    low: np.ndarray, high: np.ndarray, width: int, height: int, tile: int
) -> tuple[np.ndarray, np.ndarray]:
    """First tile that each rectangle touches and the one after its last, column and row, of shape (n, 2)."""
    most = np.array([-(-width // tile), -(-height // tile)])
    first = np.clip(np.floor(low / tile), 0, most).astype(int)
    last = np.clip(np.floor(high / tile) + 1, 0, most).astype(int)
    return first, np.maximum(first, last)


def _pixels(tiles: np.ndarray, width: int, height: int) -> np.ndarray:
    """Pixels of tiles, indices in a flat picture, int32."""
    mask = tiles.repeat(_TILE, axis=0).repeat(_TILE, axis=1)[:height, :width]
    return np.flatnonzero(mask).astype(np.int32)
