# SPDX-License-Identifier: Apache-2.0
"""Tree crowns: branches and foliage of each species."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .tree_shapes import Piece, clumps, fronds, leaves, tubes, unit

__all__ = ["Crown", "Stem", "beech", "birch", "oak", "pine", "spruce"]

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class Stem:
    """Stem on which a crown grows.

    Attributes:
        height: Of the tree [m].
        crown_base: Height at which the crown begins [m].
        crown_radius: Its reach [m].
        age: 0 for a sapling to 1 for a grown tree.
        middle: Points ``(N, 3)`` of the trunk's middle line at heights ``(N,)`` [m].
        radius: Radii of the trunk there ``(N,)`` [m].
    """

    height: float
    crown_base: float
    crown_radius: float
    age: float
    middle: Callable[[np.ndarray], np.ndarray]
    radius: Callable[[np.ndarray], np.ndarray]


@dataclass
class Crown:
    """Pieces of a crown, by material."""

    wood: list[Piece] = field(default_factory=list)
    dark: list[Piece] = field(default_factory=list)
    light: list[Piece] = field(default_factory=list)


def _between(young: float, old: float, age: float) -> float:
    """Interpolate between a sapling and a grown tree."""
    return young + (old - young) * age


def _around(count: int, rng: np.random.Generator, spread: float = 0.35) -> np.ndarray:
    """Azimuths [rad] by the golden angle, so that neighbours point in different directions."""
    return rng.uniform(0.0, 2.0 * np.pi) + _GOLDEN * np.arange(count) + spread * rng.uniform(-1.0, 1.0, count)


def _flat(azimuth: np.ndarray) -> np.ndarray:
    """Horizontal unit vectors, ``(N, 3)``."""
    return np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)])


def _limbs(
    stem: Stem,
    rng: np.random.Generator,
    start: np.ndarray,
    ends: np.ndarray,
    share: float,
    kink: float,
    points: int = 4,
) -> Piece:
    """Branches from the trunk at heights ``start`` [m] to ``ends``, three-sided, rising ever steeper."""
    # straight from the trunk to the end, sagging at first, with random kinks in between
    foot = stem.middle(start)
    t = np.linspace(0.0, 1.0, points)
    path = foot[:, None] + t[:, None] * (ends - foot)[:, None]
    rise = ends[:, 2] - foot[:, 2]
    path[..., 2] += (t**1.7 - t) * rise[:, None]
    bend = rng.normal(0.0, kink, path.shape) * np.linalg.norm(ends - foot, axis=1)[:, None, None]
    bend[:, [0, -1]] = 0.0
    radii = share * stem.radius(start)[:, None] * np.linspace(1.0, 0.35, points)[None, :-1]
    return tubes(path + bend, radii, 3)


def _coat(
    rng: np.random.Generator,
    centers: np.ndarray,
    radii: np.ndarray,
    count: int,
    size: float,
    tilt: float,
    droop: float,
    slim: float = 1.0,
    lowest: float = -0.45,
) -> Piece:
    """Leaves on the surfaces of clumps, where no other clump is in front of them.

    ``size`` is their length as a share of the mean radius, ``tilt`` the amount of random turning, ``droop`` how much
    their tips point down, ``lowest`` the lower end of the leaves on a clump, from -1 to 1.
    """
    # three times as many candidates as leaves, spread evenly over each clump
    each = int(np.ceil(3.0 * count / len(centers)))
    k = np.arange(each) + 0.5
    z = 1.0 - (1.0 - lowest) * k / each
    angle = _GOLDEN * k + rng.uniform(0.0, 2.0 * np.pi, len(centers))[:, None]
    sphere = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z + 0 * angle], axis=-1)
    out = unit(sphere + 0.25 * rng.normal(size=sphere.shape))
    at = (centers[:, None] + out * radii[:, None] * rng.uniform(0.86, 1.1, (*out.shape[:2], 1))).reshape(-1, 3)
    owner = np.repeat(np.arange(len(centers)), each)
    # those deepest inside of another clump are dropped first: nobody would see them
    near = (((at[:, None] - centers) / radii) ** 2).sum(axis=-1)
    near[np.arange(len(at)), owner] = np.inf
    hidden = near.min(axis=1) if len(centers) > 1 else np.full(len(at), np.inf)
    keep = np.sort(np.argsort(-np.minimum(hidden, 0.9) + 0.2 * rng.random(len(at)), kind="stable")[:count])
    at, owner, normal = at[keep], owner[keep], out.reshape(-1, 3)[keep] / radii[owner[keep]]
    normal = unit(normal) + tilt * rng.normal(size=normal.shape)
    along = rng.normal(size=normal.shape) * [1.0, 1.0, 0.7] + [0.0, 0.0, -droop]
    length = size * radii[owner].mean(axis=1) * rng.uniform(0.7, 1.35, len(at))
    return leaves(at, normal, length, slim * length * rng.uniform(0.75, 1.2, len(at)), along)


def spruce(stem: Stem, rng: np.random.Generator) -> Crown:
    """A spire of whorls whose branches droop, ragged; dead branches below it on tall trees."""
    crown, height, base = Crown(), stem.height, stem.crown_base
    whorls = round(_between(7, 15, stem.age))
    t = (np.arange(whorls) / whorls) ** 0.9
    level = base + (0.97 * height - base) * t
    reach = stem.crown_radius * (1.0 - t) ** 0.8 * rng.uniform(0.85, 1.1, whorls)
    number = np.clip(np.round(4 + 5 * (1 - t) + rng.uniform(-0.5, 0.5, whorls)), 4, 9).astype(int)
    owner = np.repeat(np.arange(whorls), number)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
    azimuth = 2.0 * np.pi * (rank / number[owner]) + rng.uniform(0.0, 2.0 * np.pi, whorls)[owner]
    azimuth += rng.uniform(-0.25, 0.25, len(owner))
    gap = (height - base) / whorls
    z = level[owner] + 0.3 * gap * rng.uniform(-1.0, 1.0, len(owner))
    length = reach[owner] * rng.uniform(0.72, 1.12, len(owner)) + 0.04 * gap
    drop = length * (0.25 + 0.3 * (1 - t[owner])) * rng.uniform(0.7, 1.3, len(owner))
    z = np.maximum(z, base + drop * 0.6)
    width = np.maximum(0.66 * length, 0.5 * gap) * rng.uniform(0.8, 1.2, len(owner))
    hang = (0.3 * length + 0.3 * gap) * rng.uniform(0.7, 1.3, len(owner))
    fork = rng.random(len(owner)) < 0.4
    for part, pick in ((crown.light, fork), (crown.dark, ~fork)):
        part.append(fronds(stem.middle(z[pick]), azimuth[pick], length[pick], drop[pick], width[pick], hang[pick]))
    low = base + 0.25 * gap
    path = stem.middle(np.array([low, low + 0.02 * (height - low), low + 0.5 * (height - low), height]))
    wide = 0.42 * stem.crown_radius
    crown.dark.append(tubes(path[None], np.array([[0.35 * wide, wide, 0.5 * wide]]), 6))
    dead = round(9 * np.clip((base - 1.5) / 4.0, 0.0, 1.0))
    if dead:
        start = rng.uniform(0.35, 1.0, dead) * base
        out = _flat(_around(dead, rng)) * (stem.crown_radius * rng.uniform(0.2, 0.5, dead))[:, None]
        ends = stem.middle(start) + out - [0.0, 0.0, 0.12 * stem.crown_radius]
        crown.wood.append(_limbs(stem, rng, start, ends, 0.14, 0.02, 3))
    return crown


def pine(stem: Stem, rng: np.random.Generator) -> Crown:
    """Flat clumps on crooked branches at the top of a long bare trunk; a looser cone when young."""
    crown, height, base, reach = Crown(), stem.height, stem.crown_base, stem.crown_radius
    deep = height - base
    count = round(_between(8, 9, stem.age))
    t = (np.arange(count) + 0.3) / count
    cone, dome = 1.0 - 0.9 * t, np.sqrt(np.maximum(1.0 - ((t - 0.35) / 0.72) ** 2, 0.02))
    out = reach * 0.6 * ((1.0 - stem.age) * cone + stem.age * dome) * rng.uniform(0.75, 1.15, count)
    wide = reach * (0.36 + 0.28 * ((1.0 - stem.age) * cone + stem.age * dome)) * rng.uniform(0.8, 1.2, count)
    tall = np.maximum(0.36 * wide, _between(0.55, 0.75, stem.age) * deep / count) * rng.uniform(0.8, 1.2, count)
    radii = np.column_stack([wide, wide * rng.uniform(0.75, 1.0, count), tall])
    z = base + deep * (0.08 + 0.86 * t)
    centers = stem.middle(z) + _flat(_around(count, rng)) * out[:, None]
    start = np.maximum(z - 0.5 * out - 0.1 * deep, 0.85 * base)
    crown.wood.append(_limbs(stem, rng, start, centers, 0.4, 0.06, 3))
    crown.dark.append(clumps(centers, 0.7 * radii, rng, 0.3, 0.3))
    crown.light.append(_coat(rng, centers, radii, round(_between(160, 225, stem.age)), 0.85, 0.55, -0.8, 0.6, -0.4))
    return crown


def beech(stem: Stem, rng: np.random.Generator) -> Crown:
    """A broad ovoid of overlapping clumps on steep branches."""
    crown, height, base, reach = Crown(), stem.height, stem.crown_base, stem.crown_radius
    count = round(_between(5, 9, stem.age))
    t = (np.arange(count) + 0.2) / count
    deep = height - base
    round_off = np.sqrt(np.maximum(1.0 - ((t - 0.3) / 0.75) ** 2, 0.0))
    out = reach * 0.58 * round_off * rng.uniform(0.8, 1.15, count)
    wide = reach * (0.3 + 0.2 * round_off) * rng.uniform(0.85, 1.2, count)
    radii = np.column_stack([wide, wide * rng.uniform(0.85, 1.1, count), deep * 0.19 * rng.uniform(0.85, 1.15, count)])
    z = base + deep * (0.17 + 0.68 * t)
    centers = stem.middle(z) + _flat(_around(count, rng)) * out[:, None]
    crown.wood.append(_limbs(stem, rng, np.maximum(z - 0.28 * deep, 0.75 * base), centers, 0.45, 0.03, 3))
    crown.dark.append(clumps(centers, 0.8 * radii, rng, 0.3, 0.55))
    crown.light.append(_coat(rng, centers, radii, round(_between(170, 300, stem.age)), 0.48, 0.4, 0.3, 1.0, -0.75))
    return crown


def oak(stem: Stem, rng: np.random.Generator) -> Crown:
    """Wide clumps apart from each other on thick crooked limbs."""
    crown, height, base, reach = Crown(), stem.height, stem.crown_base, stem.crown_radius
    count = round(_between(6, 9, stem.age))
    t = (np.arange(count) + 0.3) / count
    deep = height - base
    out = reach * 0.66 * np.sqrt(np.maximum(1.0 - ((t - 0.25) / 0.8) ** 2, 0.0)) * rng.uniform(0.75, 1.12, count)
    wide = reach * 0.44 * rng.uniform(0.75, 1.25, count)
    tall = np.maximum(wide * rng.uniform(0.5, 0.75, count), 0.13 * deep)
    radii = np.column_stack([wide, wide * rng.uniform(0.8, 1.2, count), tall])
    z = base + deep * (0.2 + 0.66 * t)
    centers = stem.middle(np.minimum(z, 0.7 * height)) + _flat(_around(count, rng)) * out[:, None]
    centers[:, 2] = z
    start = np.clip(z - 0.25 * deep - 0.3 * out, 0.8 * base, 0.65 * height)
    crown.wood.append(_limbs(stem, rng, start, centers, 0.55, 0.05, 4))
    crown.dark.append(clumps(centers, 0.72 * radii, rng, 0.36, 0.4))
    crown.light.append(_coat(rng, centers, radii, round(_between(170, 245, stem.age)), 0.58, 0.55, 0.2, 1.0, -0.75))
    return crown


def birch(stem: Stem, rng: np.random.Generator) -> Crown:
    """Thin steep branches that bend over, with leaves hanging from them in strands and sky between."""
    crown, height, base, reach = Crown(), stem.height, stem.crown_base, stem.crown_radius
    count = round(_between(6, 11, stem.age))
    t = (np.arange(count) + 0.5) / count
    deep = height - base
    start = base + deep * (0.02 + 0.84 * t)
    out = reach * (0.2 + 0.8 * np.sqrt(np.maximum(1.0 - ((t - 0.2) / 0.82) ** 2, 0.0))) * rng.uniform(0.75, 1.0, count)
    rise = np.minimum(deep * 0.26 * rng.uniform(0.8, 1.2, count), 1.5 * (height - start))
    foot, direction = stem.middle(start), _flat(_around(count, rng))

    def along(s: np.ndarray) -> np.ndarray:
        path = foot[:, None] + direction[:, None] * (out[:, None] * s**0.85)[..., None]
        path[..., 2] += rise[:, None] * (2.0 * s - 1.1 * s**2 - 0.35 * s**4)
        return path

    radii = 0.3 * stem.radius(start)[:, None] * np.array([1.0, 0.6])
    crown.wood.append(tubes(along(np.tile([0.0, 0.4, 0.9], (count, 1))), radii, 3))
    each = round(_between(24, 34, stem.age))
    at = along(rng.uniform(0.15, 1.0, (count, each)) ** 0.7).reshape(-1, 3)
    at += rng.normal(0.0, 1.0, at.shape) * [0.11 * reach, 0.11 * reach, 0.035 * deep]
    length = (0.034 * deep + 0.16 * reach) * rng.uniform(0.6, 1.4, len(at))
    at[:, 2] -= 0.3 * length
    normal = np.repeat(direction, each, axis=0) + 0.7 * rng.normal(size=at.shape) + [0.0, 0.0, 0.3]
    down = rng.normal(0.0, 0.3, at.shape) - [0.0, 0.0, 1.0]
    piece = (at, normal, length, 0.52 * length, down)
    pick = rng.random(len(at)) < 0.35
    crown.dark.append(leaves(*(x[pick] for x in piece)))
    crown.light.append(leaves(*(x[~pick] for x in piece)))
    return crown
