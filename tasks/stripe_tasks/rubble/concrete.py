# SPDX-License-Identifier: Apache-2.0
"""Concrete pieces: slabs, beams, columns and lumps, with the steel in them."""

from __future__ import annotations

import math

import numpy as np
import trimesh

from stripe_newton.specifications import Collider, MeshPart

from .making import BROKEN, CONCRETE, STEEL, bent, mottled, piece, shades, stub_bars
from .rafts import raft, upright
from .resting import Piece
from .shapes import Surface, bar, broken_outline, joined, plate, toned

__all__ = ["beam", "chunk", "column", "rebar", "slab"]


def slab(name: str, half_x: float, half_y: float, thickness: float, rng: np.random.Generator) -> Piece:
    """Part of a floor with one or more broken sides, from which bars stick out; its middle is the origin.

    Args:
        name: An identifier.
        half_x: Half the length [m].
        half_y: Half the width [m].
        thickness: Thickness [m].
        rng: Generator of all random numbers.
    """
    # about half of the sides are broken, the one at +x always
    deep = np.where(rng.random(4) < 0.55, rng.uniform(0.1, 0.24, 4) * min(1.0, 1.4 * half_y), 0.0)
    deep[1] = max(deep[1], 0.12)
    outline = broken_outline(half_x, half_y, (deep[0], deep[1], deep[2], deep[3]), rng)
    faces, rim = plate(outline, thickness, 0.06, rng)
    stubs = []
    for side, way in ((1, (1.0, 0.0, 0.0)), (3, (-1.0, 0.0, 0.0))):
        # a bar every 19 cm, as reinforcement has them, from inside of the broken edge
        if deep[side]:
            for y in np.arange(-half_y + 0.18, half_y - 0.1, 0.19):
                y += rng.uniform(-0.04, 0.04)
                ends = outline[np.abs(outline[:, 1] - y) < 0.2] * way[0]
                reach = ends[:, 0].max(initial=0.0) - 0.06
                stubs.append(((way[0] * reach, y, rng.uniform(-0.25, 0.25) * thickness), way))
    tones = shades(CONCRETE, rng, (1.0, 0.91, 1.08))
    parts = toned("face", faces, mottled(faces, rng, 3), tones)
    parts += toned("rim", rim, mottled(rim, rng, 2), shades(BROKEN, rng, (1.0, 0.8)))
    ends = np.array(stubs)
    parts.append(stub_bars(ends, rng))
    return piece(name, "slab", parts, raft(half_x, half_y, thickness, outline), ends)


def _prism(half: float, width: float, high: float, cut: float, rng: np.random.Generator) -> Surface:
    """Bar of rectangular section along x, whose end at +x is broken over a length ``cut`` [m]."""
    ring = np.array([(-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0)]) * (width, high) * 0.5
    at = [-half, -0.3 * half, 0.4 * half, half - cut]
    corners = np.concatenate(
        [np.column_stack([np.full(8, x), ring + rng.uniform(-0.004, 0.004, (8, 2))]) for x in at]
        + [np.column_stack([half - cut * rng.random(8), 0.85 * ring]), [[half - 0.5 * cut, 0, 0], [-half, 0, 0]]]
    )
    i = np.arange(8)
    j = (i + 1) % 8
    faces = [np.column_stack(t) + 8 * k for k in range(4) for t in ((i, i + 8, j + 8), (i, j + 8, j))]
    faces += [np.column_stack([i + 32, np.full(8, 40), j + 32]), np.column_stack([j, np.full(8, 41), i])]
    return corners, np.concatenate(faces)[:, ::-1]


def beam(name: str, length: float, width: float, height: float, rng: np.random.Generator) -> Piece:
    """Concrete beam along x with one broken end; its middle is the origin. Sizes in metres."""
    half, cut = 0.5 * length, 0.3
    surface = _prism(half, width, height, cut, rng)
    stubs = np.array([[(half - 0.5 * cut, y * width, z * height), (1, 0, 0)] for y in (-0.3, 0.3) for z in (-0.3, 0.3)])
    ends = surface[0][surface[1]].mean(axis=1)[:, 0] > half - 0.7 * cut
    tone = np.where(ends, 2, mottled(surface, rng, 2))
    parts = toned("face", surface, tone, [*shades(CONCRETE, rng, (0.95, 0.86)), *shades(BROKEN, rng, (1.0,))])
    parts.append(stub_bars(stubs, rng))
    turned = raft(half - 0.5 * cut, 0.5 * width, min(width, height), spacing=2.0)
    moved = tuple(Collider(c.kind, c.size, (c.pos[0] - 0.5 * cut, c.pos[1], 0.0), c.rot) for c in turned)
    return piece(name, "beam", parts, moved, stubs)


def column(name: str, height: float, width: float, rng: np.random.Generator) -> Piece:
    """Standing rest of a column, its top broken off, with bars; the origin is on the ground, 0.5 m above its foot."""
    (corners, faces), half = _prism(0.5 * (height + 0.5), width, width, 0.35, rng), 0.5 * (height + 0.5)
    surface = corners[:, [2, 1, 0]] * (-1, 1, 1) + (0, 0, half - 0.5), faces
    spots = [(x * width, y * width, height - 0.25) for x in (-0.34, 0.34) for y in (-0.34, 0, 0.34)]
    steel = []
    for spot in spots:
        line = bent(rng.uniform(0.3, 0.75), rng.uniform(-0.9, 0.9), rng)[:, [1, 2, 0]]
        steel.append(bar(np.array(spot) + line, 0.009))
    top = surface[0][surface[1]].mean(axis=1)[:, 2] > height - 0.3
    tone = np.where(top, 2, mottled(surface, rng, 2))
    parts = toned("face", surface, tone, [*shades(CONCRETE, rng, (0.98, 0.87)), *shades(BROKEN, rng, (1.0,))])
    parts.append(MeshPart("steel", *joined(steel), STEEL, 0.8))
    return piece(name, "column", parts, (upright(0.0, -0.5, height - 0.12, 0.55 * width),))


def rebar(name: str, length: float, bend: float, rng: np.random.Generator) -> Piece:
    """Bar that sticks out of concrete at the origin along x and bends up; a capsule from its root to its tip."""
    line, radius = bent(length, bend, rng), 0.009
    parts = [MeshPart("steel", *bar(line - 0.06 * (line[1] / np.linalg.norm(line[1])), radius, 6), STEEL, 0.75)]
    tip = line[-1]
    # the shortest turn from the z axis to the tip
    axis = tip / np.linalg.norm(tip)
    turn = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    x, y, z, w = (float(t) for t in turn / np.linalg.norm(turn))
    middle = 0.5 * tip
    place = float(middle[0]), float(middle[1]), float(middle[2])
    half = 0.5 * float(np.linalg.norm(tip))
    return piece(name, "rebar", parts, (Collider("capsule", (0.02, half), place, (x, y, z, w)),))


def chunk(name: str, radius: float, rng: np.random.Generator) -> Piece:
    """Lump of concrete with flat sides, ``2 radius`` wide along x; its middle is the origin."""
    # hull of some points of a sphere: about twenty flat sides
    corners = rng.standard_normal((14, 3))
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    low, high = corners.min(axis=0), corners.max(axis=0)
    corners = (corners - 0.5 * (low + high)) / (0.5 * (high - low))
    hull = trimesh.convex.convex_hull(corners * (1.0, 0.72, 0.6) * radius)
    surface = np.asarray(hull.vertices), np.asarray(hull.faces)
    parts = toned("lump", surface, mottled(surface, rng, 2), shades(BROKEN, rng, (1.25, 0.95)))
    quarter = math.sqrt(0.5)
    touched = Collider("capsule", (0.55 * radius, 0.32 * radius), rot=(0.0, quarter, 0.0, quarter))
    return piece(name, "chunk", parts, (touched,))
