# SPDX-License-Identifier: Apache-2.0
"""Making of pieces: colours, bent bars, and samples of the surface on which others rest."""

from __future__ import annotations

import numpy as np
import trimesh

from stripe_newton.specifications import Collider, MeshPart

from .resting import Piece
from .shapes import Surface, bar, joined

__all__ = [
    "BRICKS",
    "BROKEN",
    "CONCRETE",
    "MORTAR",
    "PIPES",
    "PLASTER",
    "STEEL",
    "Color",
    "bent",
    "mottled",
    "piece",
    "shades",
    "stub_bars",
]

Color = tuple[float, float, float]
CONCRETE, BROKEN, STEEL = (0.355, 0.325, 0.285), (0.26, 0.235, 0.2), (0.115, 0.05, 0.026)
BRICKS: list[Color] = [(0.31, 0.155, 0.105), (0.24, 0.11, 0.08), (0.34, 0.21, 0.155), (0.33, 0.28, 0.235)]
MORTAR, PLASTER = (0.37, 0.34, 0.29), (0.47, 0.41, 0.32)
PIPES: list[Color] = [(0.12, 0.10, 0.095), (0.30, 0.15, 0.08), (0.36, 0.37, 0.37)]


def shades(color: Color, rng: np.random.Generator, factors: tuple[float, ...]) -> list[Color]:
    """Brighter and darker shades of a colour, which is varied a little first."""
    base = np.array(color) * rng.uniform(0.88, 1.12) * (1.0 + 0.01 * rng.standard_normal(3))
    return [(float(r), float(g), float(b)) for r, g, b in (np.clip(base * f, 0.01, 1.0) for f in factors)]


def piece(
    name: str, kind: str, parts: list[MeshPart], touched: tuple[Collider, ...], stubs: np.ndarray | None = None
) -> Piece:
    """Make a piece and sample its surface, without the steel, so that others can rest on it."""
    solid = [p for p in parts if not p.name.startswith("steel")] or parts
    corners, faces = joined([(p.vertices.astype(float), p.faces) for p in solid])
    body = trimesh.Trimesh(corners, faces, process=False)
    count = int(np.clip(body.area / 0.0025, 60, 9000))
    samples = np.asarray(trimesh.sample.sample_surface(body, count, seed=0)[0])
    low, high = corners.min(axis=0), corners.max(axis=0)
    # a grid of 14 cells each way keeps the number of feet small
    cell = np.maximum((high - low)[:2] / 14.0, 1.0e-6)  # feet: the lowest sample of each cell of a grid
    index = np.minimum((samples[:, :2] - low[:2]) // cell, 13).astype(int) @ (14, 1)
    order = np.lexsort((samples[:, 2], index))
    feet = samples[order[np.unique(index[order], return_index=True)[1]]]
    radius = float(np.hypot(*np.abs(corners[:, :2]).max(axis=0)))
    ends = np.zeros((0, 2, 3)) if stubs is None else stubs
    return Piece(name, parts, touched, kind, radius, samples, feet, ends, kind in ("wall", "column"))


def mottled(surface: Surface, rng: np.random.Generator, tones: int) -> np.ndarray:
    """Index of a tone for each face, in patches."""
    middle = surface[0][surface[1]].mean(axis=1)
    wave = sum(np.sin(middle @ rng.normal(0.0, 2.5, 3) + rng.uniform(0.0, 6.3)) for _ in range(4))
    level = wave + 0.9 * rng.standard_normal(len(middle))
    edges = np.quantile(level, np.linspace(0.0, 1.0, tones + 1)[1:-1])
    return np.searchsorted(edges, level)


def bent(length: float, bend: float, rng: np.random.Generator) -> np.ndarray:
    """Line from the origin along x that bends up, ``(7, 3)`` [m]."""
    share = np.linspace(0.0, 1.0, 7)
    turn = bend * np.clip(share - rng.uniform(0.0, 0.35), 0.0, None) * 1.5
    steps = np.column_stack([np.cos(turn), 0.25 * np.sin(3.0 * share) * rng.uniform(-1.0, 1.0), np.sin(turn)])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps[:-1], axis=0)]) * length / 6.0


def stub_bars(stubs: np.ndarray, rng: np.random.Generator) -> MeshPart:
    """Short ends of bars, at points and in directions ``(K, 2, 3)``."""
    found = []
    for point, way in stubs:
        line = bent(rng.uniform(0.06, 0.28), rng.uniform(-1.2, 1.2), rng)
        side = np.array([-way[1], way[0], 0.0])
        found.append(bar(point - 0.05 * way + line @ np.array([way, side, (0.0, 0.0, 1.0)]), 0.008))
    return MeshPart("steel", *joined(found), STEEL, 0.8)
