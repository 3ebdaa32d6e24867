# SPDX-License-Identifier: Apache-2.0
"""Capsules in the world frame, and a grid of cells that lists those that touch each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["Capsules", "CellLists", "list_cells"]

_SHAPES = {"positions": (3,), "rotations": (4,), "radius": (), "half_length": ()}
SHORTEST = 1.0e-4
"""Half length that shorter capsules, such as spheres, get [m]: an axis needs a direction."""
MAX_CELLS = 1 << 20
"""Limit on the cells of a grid; where there would be more they are made larger."""


class ColliderShape(Protocol):
    """A collider in the frame of its asset, such as ``spec.Collider``."""

    @property
    def kind(self) -> str:
        """``"sphere"``, ``"capsule"``, ``"cylinder"`` or ``"box"``."""

    @property
    def size(self) -> Sequence[float]:
        """Radius, and half length of the axis [m]; half extents of a box."""

    @property
    def pos(self) -> Sequence[float] | np.ndarray:
        """Position [m]."""

    @property
    def rot(self) -> Sequence[float] | np.ndarray:
        """Orientation (x, y, z, w)."""


@dataclass(frozen=True, eq=False)
class Capsules:
    """Capsules in the world frame; a sphere is one of half length 0. Numbers for all may be given once.

    Attributes:
        positions: Centres [m], float32 ``(N, 3)``.
        rotations: Orientations, xyzw, float32 ``(N, 4)``; the axis is z. Brought to unit length.
        radius: Radii [m], float32 ``(N,)``.
        half_length: Half lengths of the axes, without the caps [m], float32 ``(N,)``.
    """

    positions: np.ndarray
    rotations: np.ndarray
    radius: np.ndarray
    half_length: np.ndarray

    def __post_init__(self) -> None:
        count = len(np.atleast_2d(np.asarray(self.positions, dtype=np.float32)))
        count = 0 if np.size(self.positions) == 0 else count
        for name, shape in _SHAPES.items():
            object.__setattr__(self, name, _for_each(name, getattr(self, name), (count, *shape)))
        for name, wrong in (("radius", self.radius <= 0.0), ("half_length", self.half_length < 0.0)):
            if wrong.any():
                i = int(np.flatnonzero(wrong)[0])
                least = "above 0" if name == "radius" else "0 or more"
                raise ValueError(f"{name}: obstacle {i} has {getattr(self, name)[i]}, must be {least} [m]")
        length = np.linalg.norm(self.rotations, axis=1, keepdims=True)
        if (length < 1e-6).any():
            raise ValueError(f"rotations: obstacle {int(np.flatnonzero(length < 1e-6)[0])} has zeros, must be xyzw")
        object.__setattr__(self, "rotations", self.rotations / length)
        object.__setattr__(self, "half_length", np.maximum(self.half_length, np.float32(SHORTEST)))

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def none(cls) -> Capsules:
        """No capsules."""
        return cls(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0), np.zeros(0))

    @classmethod
    def from_colliders(
        cls, colliders: Sequence[ColliderShape], poses: np.ndarray, scales: np.ndarray | float = 1.0
    ) -> Capsules:
        """The spheres, capsules and cylinders of an asset, at each of its instances.

        A cylinder becomes the capsule of its radius and half length, whose caps protrude at its ends.

        Args:
            colliders: Colliders in the frame of the asset.
            poses: Position [m] and orientation, xyzw, of each instance in the world, shape ``(M, 7)``.
            scales: Sizes relative to the asset, shape ``(M,)`` or one for all.

        Raises:
            ValueError: for a box, which no capsule can represent, and for poses of another shape.
        """
        poses = np.asarray(poses, dtype=np.float64).reshape(-1, 7) if np.size(poses) % 7 == 0 else poses
        if np.ndim(poses) != 2 or np.shape(poses)[1] != 7:
            raise ValueError(f"poses: has shape {np.shape(poses)}, must have (M, 7): position and xyzw")
        scales = np.broadcast_to(np.asarray(scales, dtype=np.float64), len(poses))
        position, rotation, radius, half = [], [], [], []
        for number, collider in enumerate(colliders):
            if collider.kind not in ("sphere", "capsule", "cylinder"):
                raise ValueError(
                    f"colliders: number {number} is a {collider.kind}, which no capsule stands for; "
                    "use capsules, cylinders and spheres, or make it a static asset of the scene"
                )
            offset = np.asarray(collider.pos, dtype=np.float64) * scales[:, None]
            position.append(poses[:, :3] + _rotate(poses[:, 3:], offset))
            rotation.append(_multiply(poses[:, 3:], np.asarray(collider.rot, dtype=np.float64)))
            radius.append(scales * collider.size[0])
            half.append(scales * (0.0 if collider.kind == "sphere" else collider.size[1]))
        if not position:
            return cls.none()
        return cls(*(np.concatenate(values) for values in (position, rotation, radius, half)))

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corners of their axis-aligned boxes in the plane [m], float64 ``(N, 2)`` each."""
        x, y, z, w = self.rotations.astype(np.float64).T
        axis = np.column_stack([2.0 * (x * z + y * w), 2.0 * (y * z - x * w)])  # the rotated z axis, in the plane
        extent = np.abs(axis) * self.half_length[:, None] + self.radius[:, None]
        return self.positions[:, :2] - extent, self.positions[:, :2] + extent


def _for_each(name: str, given: ArrayLike, wanted: tuple[int, ...]) -> np.ndarray:
    """Numbers of the shape ``wanted``, repeated where they were given once for all; ``name`` is for errors."""
    value = np.asarray(given, dtype=np.float32)
    if value.size == 0 and wanted[0] == 0:
        value = value.reshape(wanted)
    try:
        value = np.ascontiguousarray(np.broadcast_to(value, wanted))
    except ValueError:
        raise ValueError(f"{name}: has shape {value.shape}, must have {wanted} as positions has") from None
    if not np.isfinite(value).all():
        raise ValueError(f"{name}: number {np.flatnonzero(~np.isfinite(value))[0]} of them is not finite")
    return value


def _multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Product of quaternions (x, y, z, w)."""
    vector = p[..., 3:] * q[..., :3] + q[..., 3:] * p[..., :3] + np.cross(p[..., :3], q[..., :3])
    return np.concatenate([vector, p[..., 3:] * q[..., 3:] - (p[..., :3] * q[..., :3]).sum(-1, keepdims=True)], axis=-1)


def _rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors rotated by quaternions (x, y, z, w), not necessarily of unit length."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    twice = 2.0 * np.cross(q[..., :3], v)
    return v + q[..., 3:] * twice + np.cross(q[..., :3], twice)


@dataclass(frozen=True, eq=False)
class CellLists:
    """A grid in the plane and the obstacles that each of its cells lists.

    Attributes:
        lower: World x and y of its corner [m], ``(2,)``.
        size: Width of a cell [m].
        shape: Number of columns, along x, and rows, along y.
        first: Column and row of the first cell that lists each obstacle, int32 ``(N, 2)``.
        cell: Column and row of the cell of each entry of ``listed``, int32 ``(K, 2)``.
        start: Where the list of each cell starts, row by row, int32 ``(cells + 1,)``.
        listed: Indices of obstacles, list after list, each ascending, int32.
    """

    lower: np.ndarray
    size: float
    shape: tuple[int, int]
    first: np.ndarray
    cell: np.ndarray
    start: np.ndarray
    listed: np.ndarray

    def ends(self, capsules: Capsules) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the axes by entry of the lists: ``low_end`` and ``high_end`` of ``ObstacleData``, ``(K, 4)`` each."""
        axis = capsules.half_length[:, None] * _rotate(capsules.rotations.astype(np.float64), np.array([0.0, 0.0, 1.0]))
        first = self.cell == self.first[self.listed]
        # The fourth number says whether an entry is in the first column and row of its obstacle, so that a search over
        # several cells counts an obstacle once, without a memory of those that it has seen.
        code = 4 * self.cell[:, 0] + 2 * first[:, 0] + first[:, 1]
        low = np.column_stack([(capsules.positions - axis)[self.listed], capsules.radius[self.listed]])
        high = np.column_stack([(capsules.positions + axis)[self.listed], code])
        return low.astype(np.float32), high.astype(np.float32)


def list_cells(capsules: Capsules, size: float, max_listed: int, max_cells: int = MAX_CELLS) -> CellLists:
    """List each capsule in every cell that its axis-aligned box touches.

    Args:
        capsules: The capsules.
        size: Width of a cell [m]; wider where the cells or the lists would not fit.
        max_listed: Room for the lists, at least one entry for each capsule.
        max_cells: Room for cells.
    """
    if not len(capsules):
        none = np.zeros(1, dtype=np.int32)
        nowhere = np.zeros((0, 2), np.int32)
        return CellLists(np.zeros(2), size, (0, 0), nowhere, nowhere, none, none[:0])
    lower, upper = capsules.bounds
    pad = 1e-4 + 1e-6 * max(np.abs(lower).max(), np.abs(upper).max())  # what float32 on the device may round away
    lower, upper = lower - pad, upper + pad
    corner = lower.min(axis=0)
    # Cells as wide as the search reaches, so that it looks into few of them; wider if their lists outgrow the room.
    while True:
        first, last = np.floor((lower - corner) / size), np.floor((upper - corner) / size)
        shape, span = last.max(axis=0) + 1.0, last - first + 1.0
        if shape.prod() <= max_cells and span.prod(axis=1).sum() <= max_listed:
            break
        size *= 1.25
    columns, rows = int(shape[0]), int(shape[1])
    first, span = first.astype(np.int64), span.astype(np.int64)
    each = span.prod(axis=1)
    # An entry for each pair of obstacle and cell, then sorted by cell: the sort is stable, so that lists ascend.
    ids = np.repeat(np.arange(len(capsules)), each)
    within = np.arange(len(ids)) - np.repeat(each.cumsum() - each, each)
    cell = (first[ids, 1] + within // span[ids, 0]) * columns + first[ids, 0] + within % span[ids, 0]
    start = np.zeros(columns * rows + 1, dtype=np.int32)
    start[1:] = np.bincount(cell, minlength=columns * rows).cumsum()
    order = np.argsort(cell, kind="stable")
    places = np.column_stack([cell[order] % columns, cell[order] // columns]).astype(np.int32)
    listed = ids[order].astype(np.int32)
    return CellLists(corner, size, (columns, rows), first.astype(np.int32), places, start, listed)
