# SPDX-License-Identifier: Apache-2.0
"""Trees: meshes of a species, made from a few sizes and a generator of random numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from stripe_newton.specifications import Collider, DynamicMesh, MeshPart

from .traits import BREAST_HEIGHT
from .tree_crowns import Crown, Stem, beech, birch, oak, pine, spruce
from .tree_shapes import Piece, join, patches, tubes

__all__ = ["SPECIES_SHAPES", "SpeciesShape", "tree"]

Color = tuple[float, float, float]
_SUNK = 0.3
"""Depth of a trunk below the ground [m], so that it stands on a slope without a gap."""
_THINNEST = 0.015
"""Radius of the thinnest trunk with a collider [m]."""


@dataclass(frozen=True)
class SpeciesShape:
    """Shape and colours of a species.

    Attributes:
        crown: Function that grows branches and foliage.
        crown_base: Height at which the crown begins, as a share of the tree's, of a sapling and of a grown tree.
        grown: Height from which it looks grown [m].
        taper: Exponent of the trunk's radius over the distance from the top; below 1 it is full-bodied.
        top: Where the trunk ends, as a share of the height.
        flare: By how much the roots widen the trunk at the ground, as a share of its radius.
        sway: How crooked the trunk is, as a share of its height.
        bark: Linear RGB of trunk and branches.
        foliage: Linear RGB of the foliage within, and of the outer one.
        patches: Linear RGB of bark that differs, and up to which share of the height it reaches.
        twigs: What the triangles of the foliage stand for, see :class:`MeshPart`.
        plates: Whether that bark covers the trunk from the ground up, rather than in scars.
    """

    crown: Callable[[Stem, np.random.Generator], Crown]
    crown_base: tuple[float, float]
    grown: float
    taper: float
    top: float
    flare: float
    sway: float
    bark: Color
    foliage: tuple[Color, Color]
    patches: tuple[Color, float] | None = None
    plates: bool = False
    twigs: str = "leaves"


SPECIES_SHAPES: Mapping[str, SpeciesShape] = MappingProxyType(
    {
        "spruce": SpeciesShape(
            spruce,
            (0.06, 0.25),
            16.0,
            0.85,
            0.985,
            0.55,
            0.003,
            (0.14, 0.095, 0.07),
            ((0.014, 0.045, 0.022), (0.03, 0.08, 0.034)),
            twigs="spruce",
        ),
        "pine": SpeciesShape(
            pine,
            (0.15, 0.56),
            14.0,
            0.7,
            0.93,
            0.35,
            0.010,
            (0.33, 0.15, 0.07),
            ((0.02, 0.055, 0.032), (0.05, 0.11, 0.055)),
            ((0.12, 0.085, 0.065), 0.45),
            True,
            "pine",
        ),
        "beech": SpeciesShape(
            beech,
            (0.15, 0.36),
            14.0,
            0.7,
            0.85,
            0.7,
            0.007,
            (0.25, 0.255, 0.24),
            ((0.03, 0.085, 0.014), (0.085, 0.20, 0.03)),
        ),
        "birch": SpeciesShape(
            birch,
            (0.18, 0.35),
            12.0,
            0.8,
            0.95,
            0.3,
            0.012,
            (0.72, 0.70, 0.66),
            ((0.065, 0.14, 0.02), (0.16, 0.27, 0.045)),
            ((0.03, 0.027, 0.025), 0.85),
        ),
        "oak": SpeciesShape(
            oak,
            (0.15, 0.3),
            13.0,
            0.75,
            0.72,
            0.65,
            0.014,
            (0.125, 0.10, 0.075),
            ((0.022, 0.055, 0.012), (0.07, 0.13, 0.025)),
        ),
    }
)
"""Shapes by name; the names are those of :data:`stripe_tasks.forest.traits.SPECIES`."""


def tree(
    name: str, species: str, height: float, trunk_radius: float, crown_radius: float, rng: np.random.Generator
) -> DynamicMesh:
    """Make a tree that stands at the origin.

    Its surfaces are ``trunk`` with the branches, ``crown`` and ``crown_light`` with the inner and the outer foliage,
    and ``bark`` with the plates of a pine or the scars of a birch that is no sapling. Its collider is a capsule of up
    to 2.5 m along the trunk, unless that is thinner than 1.5 cm.

    Args:
        name: An identifier.
        species: One of :data:`SPECIES_SHAPES`.
        height: From the ground to the top [m].
        trunk_radius: At a height of 1.3 m, or at four fifths of the height of a lower tree [m].
        crown_radius: Horizontal reach of the crown [m].
        rng: Generator of all random numbers; its state fixes every byte.

    Raises:
        ValueError: for a species that is not known, or a length that is not positive and finite.
    """
    if species not in SPECIES_SHAPES:
        raise ValueError(f"tree '{name}': species is '{species}', must be one of {', '.join(SPECIES_SHAPES)}")
    for what, value in (("height", height), ("trunk_radius", trunk_radius), ("crown_radius", crown_radius)):
        if not 0.0 < value < math.inf:
            raise ValueError(f"tree '{name}': {what} is {value}, must be positive [m]")
    shape = SPECIES_SHAPES[species]
    # looks go from those of a sapling at 2 m to those of a grown tree
    age = float(np.clip((height - 2.0) / (shape.grown - 2.0), 0.0, 1.0))
    trunk = _Trunk(shape, height, trunk_radius, 8 if age > 0.3 else 6, rng)
    base = height * (shape.crown_base[0] + (shape.crown_base[1] - shape.crown_base[0]) * age) * rng.uniform(0.9, 1.1)
    crown = shape.crown(Stem(height, base, crown_radius, age, trunk.middle, trunk.radius), rng)
    stem = trunk.mesh(rng)
    wood, dark, light = _fitted(crown, trunk, height, crown_radius)
    parts = [MeshPart("trunk", *join([stem, wood]), color=shape.bark)]
    if shape.patches is not None and age > 0.2:
        parts.append(MeshPart("bark", *trunk.patches(stem, rng), color=shape.patches[0]))
    for part, piece, color in (("crown", dark, shape.foliage[0]), ("crown_light", light, shape.foliage[1])):
        parts.append(MeshPart(part, *piece, color=color, double_sided=True, foliage=shape.twigs))
    # room that it takes on the ground: the reach of its roots
    ground = stem[0][stem[0][:, 2] < 0.1]
    taken = float(np.linalg.norm(ground[:, :2], axis=1).max())
    return DynamicMesh(name, parts, trunk.colliders(), "tree", taken)


class _Trunk:
    """Middle line and radius of a trunk."""

    def __init__(self, shape: SpeciesShape, height: float, radius: float, sides: int, rng: np.random.Generator):
        self._shape, self._height, self._girth, self._sides = shape, height, radius, sides
        self._measured = min(BREAST_HEIGHT, 0.8 * height)
        azimuth, self._phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        self._lean = shape.sway * height * rng.uniform(0.2, 1.0) * np.array([np.cos(azimuth), np.sin(azimuth)])
        azimuth = azimuth + rng.uniform(1.5, 4.5)
        self._bow = shape.sway * height * rng.uniform(0.3, 1.0) * np.array([np.cos(azimuth), np.sin(azimuth)])

    def middle(self, z: np.ndarray) -> np.ndarray:
        """Points of its middle line ``(N, 3)`` [m]: a lean and a bow; straight below the ground."""
        t = np.asarray(z, dtype=np.float64) / self._height
        bow = np.sin(np.pi * np.maximum(t, 0.0) * 1.35) ** 2
        return np.column_stack([t[:, None] * self._lean + bow[:, None] * self._bow, z])

    def radius(self, z: np.ndarray) -> np.ndarray:
        """Radius ``(N,)`` [m]: a power of the distance from the top, and the roots' flare."""
        left = np.maximum(self._height - np.asarray(z), 0.0) / (self._height - self._measured)
        plain = self._girth * np.minimum(left**self._shape.taper, 1.6)
        deep = min(0.22 + 0.5 * self._girth, 0.2 * self._height)
        return plain * (1.0 + self._shape.flare * np.exp(-np.maximum(z, -0.15) / deep))

    def mesh(self, rng: np.random.Generator) -> Piece:
        """A closed tube with roots that stand out at the ground."""
        top = max(self._shape.top, 0.97 - 0.25 * max(self._height - 2.0, 0.0)) * self._height
        low = np.array([-_SUNK, 0.0, 0.12 * self._measured, 0.4 * self._measured, self._measured])
        z = np.append(low, np.linspace(self._measured, top, 4)[1:])
        sides = self._sides
        k = np.arange(sides)
        root = np.exp(-np.maximum(z[:-1], 0.0) / (0.2 * self._measured))[:, None]
        lobes = 1.0 + root * (0.16 * np.cos(0.5 * sides * 2.0 * np.pi * k / sides) + 0.12 * rng.uniform(-1, 1, sides))
        return tubes(self.middle(z)[None], self.radius(z[:-1])[None], sides, lobes[None], self._phase)

    def patches(self, stem: Piece, rng: np.random.Generator) -> Piece:
        """Plates or scars of another colour on a mesh of this trunk."""
        assert self._shape.patches is not None
        reach = self._shape.patches[1] * self._height
        rings = stem[0][:-1].reshape(-1, self._sides, 3)
        level = rings[..., 2].mean(axis=1)
        if self._shape.plates:
            ring, side = (x.reshape(-1) for x in np.indices((len(level) - 1, self._sides)))
            end = reach * rng.uniform(0.35, 1.0, (self._sides, 2))[side]
            foot = np.zeros_like(end)
        else:
            count = round(8 + 2.2 * min(reach, 14.0))
            at = reach * rng.random(count) ** 1.7
            ring, side = np.searchsorted(level[1:-1], at), rng.integers(0, self._sides, count)
            foot = at[:, None] + rng.uniform(-0.03, 0.03, (count, 2))
            end = foot + (0.35 + at[:, None] / reach) * rng.uniform(0.03, 0.28, (count, 2))
        tall = (level[ring + 1] - level[ring])[:, None]
        low, high = (np.clip((x - level[ring][:, None]) / tall, 0.0, 1.0) for x in (foot, end))
        keep = (high - low).min(axis=1) > 0.0
        return patches(rings, ring[keep], side[keep], low[keep], high[keep], 0.004 + 0.01 * self._girth)

    def colliders(self) -> list[Collider]:
        """A capsule along its lower part, or none for a thin one."""
        if self._girth < _THINNEST:
            return []
        low, high = -_SUNK, min(2.5, 0.8 * self._height)
        z = np.linspace(low, high, 15)
        line = self.middle(z)
        # the straight line nearest to the lower trunk; its radius is the mean over the lowest metre
        slope, at = np.polyfit(z, line[:, :2], 1)
        radius = float(self.radius(np.linspace(0.05, min(1.0, high), 20)).mean())
        tilt = np.array([*slope, 1.0])
        half = max(0.5 * (high - low) * float(np.linalg.norm(tilt)) - radius, 0.01)
        middle = np.array([*(at + slope * 0.5 * (low + high)), 0.5 * (low + high)])
        x, y, w = -tilt[1], tilt[0], float(np.linalg.norm(tilt)) + 1.0  # the shortest turn from z to the line
        length = math.sqrt(x * x + y * y + w * w)
        x, y, z_ = (float(c) for c in middle)
        return [Collider("capsule", (radius, half), (x, y, z_), (-tilt[1] / length, tilt[0] / length, 0.0, w / length))]


def _fitted(crown: Crown, trunk: _Trunk, height: float, reach: float) -> list[Piece]:
    """Branches, dark and light foliage, stretched to the requested height and crown radius."""
    pieces = [join(x) for x in (crown.wood, crown.dark, crown.light)]
    foliage = np.concatenate([v for v, _ in pieces[1:]])
    rise = height / foliage[:, 2].max()
    away = foliage[:, :2] - trunk.middle(foliage[:, 2])[:, :2]
    # between the mean extent and the largest distance: neither narrow nor lopsided crowns are stretched too far
    half = 0.25 * np.ptp(away, axis=0).sum()
    spread = reach / math.sqrt(half * np.linalg.norm(away, axis=1).max())
    fitted = []
    for vertices, faces in pieces:
        middle = trunk.middle(vertices[:, 2])
        sideways = vertices[:, :2] - middle[:, :2]
        z = vertices[:, 2] * rise
        fitted.append((np.column_stack([trunk.middle(z)[:, :2] + spread * sideways, z]), faces))
    return fitted
