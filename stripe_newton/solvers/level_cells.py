# SPDX-License-Identifier: Apache-2.0
"""Level cells: cells of a grid of meshes in which the surface is one plane, as on a floor away from its furniture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Cells", "level_cells"]

_SAME_NORMAL, _SAME_PLANE = 1e-6, 1e-6
"""Differences of normals and of distances from a cell's centre [m] up to which faces are in one plane."""
_BLOCK = 1_000_000
"""Faces in cells that are looked at at once, for memory."""


@dataclass(frozen=True)
class Cells:
    """Faces by the cells of a grid."""

    low: np.ndarray
    """Lowest corner of the grid [m], shape ``(3,)``."""
    size: np.ndarray
    """Cells along each axis; they are numbered along x, then y, then z."""
    length: float
    """Size of a cell [m]."""
    first: np.ndarray
    """Place of the first item of each cell, and one beyond the last, shape ``(cells + 1,)``."""
    items: np.ndarray
    """Numbers of faces, cell by cell."""

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """Centres of some cells [m], shape ``(number, 3)``."""
        columns, rows, _ = self.size
        place = np.stack([cells % columns, cells // columns % rows, cells // (columns * rows)], axis=1)
        return np.asarray(self.low + (place + 0.5) * self.length)


def level_cells(
    cells: Cells, corners: np.ndarray, normals: np.ndarray, geoms: np.ndarray, goes_on: np.ndarray
) -> np.ndarray:
    """For each cell a face whose plane may stand for all of its faces, -1 where there is none.

    The nearest point of the faces is then the nearest one of the plane, for every point of the cell.

    Args:
        cells: The faces by cells; those of a cell are all that count for its points.
        corners: Corners of the faces [m], shape ``(faces, 3, 3)``.
        normals: Their normals, shape ``(faces, 3)``.
        geoms: The geoms whose faces they are, shape ``(faces,)``.
        goes_on: Whether the surface goes on in the plane of a face beyond each of its edges, shape ``(faces, 3)``.
    """
    found = np.full(len(cells.first) - 1, -1, dtype=np.int32)
    filled = np.flatnonzero(np.diff(cells.first))
    block = np.cumsum(np.diff(cells.first)[filled]) // _BLOCK
    for number in np.unique(block):
        some = filled[block == number]
        counts = np.diff(cells.first)[some]
        start = np.cumsum(counts) - counts
        items = cells.items[cells.first[some[0]] : cells.first[some[-1]] + counts[-1]]
        centers = np.repeat(cells.centers(some), counts, axis=0)
        level = _covers(centers, cells.length, corners, normals, goes_on, items)
        distance = np.einsum("ij,ij->i", centers - corners[items, 0], normals[items])
        one = np.repeat(items[start], counts)
        same = (np.abs(normals[items] - normals[one]).max(axis=1) <= _SAME_NORMAL) & (geoms[items] == geoms[one])
        same &= np.abs(distance - np.repeat(distance[start], counts)) <= _SAME_PLANE
        ends, holds = level
        is_level = np.logical_and.reduceat(same & ~ends, start) & np.logical_or.reduceat(holds, start)
        found[some[is_level]] = items[start[is_level]]
    return found


def _covers(
    centers: np.ndarray, length: float, corners: np.ndarray, normals: np.ndarray, goes_on: np.ndarray, items: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whether the surface ends or bends at an edge of a face within a cell, and whether the face is below its centre.

    Seen along the normal of the face: of a cell its ball counts.
    """
    normal = normals[items].astype(float)
    ends, inside = np.zeros(len(items), dtype=bool), np.ones(len(items), dtype=bool)
    for k in range(3):
        a, b = (corners[items, i].astype(float) for i in (k, (k + 1) % 3))
        along, to = b - a, centers - a
        to -= np.einsum("ij,ij->i", to, normal)[:, None] * normal
        share = np.clip(np.einsum("ij,ij->i", to, along) / np.einsum("ij,ij->i", along, along), 0.0, 1.0)
        distance = np.linalg.norm(to - share[:, None] * along, axis=1)
        ends |= (distance <= 0.5 * np.sqrt(3.0) * length + 1e-4) & ~goes_on[items, k]
        inside &= np.einsum("ij,ij->i", np.cross(along, to), normal) >= -1e-9
    return ends, inside
