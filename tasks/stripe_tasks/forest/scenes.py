# SPDX-License-Identifier: Apache-2.0
"""Scenes of the forest: ordinary woods, a clearing, a path and a ravine."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from stripe_newton.sim import DistantLightCfg, DomeLightCfg
from stripe_newton.specifications import Places, SceneSpec, TerrainInstance
from stripe_newton.specifications.places import footprints
from stripe_newton.terrains import Ground

from .assets import Lying, Rocks, Stumps, Trees, Undergrowth
from .ground_cover import ground_colors
from .maps import aspect, moisture, slope, traversability
from .relief import Relief, ReliefCfg, carve_path, carve_ravine, flatten_disc, make_relief

__all__ = ["PLACES", "ClearingSpec", "ForestSpec", "PathSpec", "RavineSpec"]

PLACES: Mapping[str, Places] = {"init_pos": Places(radius=0.7, margin=4.5), "target": Places(radius=0.6, margin=4.5)}
"""Places where robots start and places to which they are sent."""
ROBOT_RADIUS, MAX_SLOPE, MAX_STEP = 0.4, math.radians(35.0), 0.35
"""Robot for which the map of traversability is made: radius [m], steepest slope [rad], highest step [m]."""


class ForestSpec(SceneSpec):
    """Forest on natural ground.

    Args:
        size: Extent in x and y [m].
        density: Stems per hectare; ordinary woods have 300 to 800.
        count: Stems in all; overrides ``density``.
        relief: Height of the hills [m].
        roughness: 0 for rounded hills, 1 for rugged ground.
        micro: Height of roots and tussocks [m].
        resolution: Spacing of the heights [m].
        years: Age of the stand: 30 for thickets, 150 for high forest.
        mix: Shares of spruce, pine, beech, birch and oak among the stems.
        rocks: Rocks per hectare; ``stumps``, ``logs`` and ``branches`` likewise. ``clutter`` multiplies them all.
        clutter: Factor on rocks, stumps, logs and branches.
        undergrowth: Factor on bushes, ferns and grass, which have no colliders.
        places: Places for robots to find.
    """

    def __init__(
        self,
        size: tuple[float, float] = (64.0, 64.0),
        density: float = 600.0,
        count: int | None = None,
        *,
        relief: float = 6.0,
        roughness: float = 0.4,
        micro: float = 0.12,
        resolution: float = 0.25,
        years: float = 120.0,
        mix: Mapping[str, float] | None = None,
        rocks: float = 80.0,
        stumps: float = 30.0,
        logs: float = 25.0,
        branches: float = 60.0,
        clutter: float = 1.0,
        undergrowth: float = 1.0,
        places: Mapping[str, Places] = PLACES,
    ):
        if np.shape(size) != (2,) or not all(5.0 <= s < math.inf for s in size):
            raise ValueError(f"{type(self).__name__}: size is {size}, must be the extent in x and y, each at least 5 m")
        self.relief = ReliefCfg(
            size, resolution, relief, roughness, micro_amplitude=micro, wavelength=min(90.0, 1.2 * max(size))
        )
        for name, value in (("clutter", clutter), ("undergrowth", undergrowth)):
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{type(self).__name__}: {name} is {value}, must be 0 or more")
        super().__init__(
            size,
            [
                Trees("trees", density, count, years, mix),
                Rocks("rocks", clutter * rocks),
                Stumps("stumps", clutter * stumps),
                Lying("logs", "log", clutter * logs),
                Lying("branches", "branch", clutter * branches),
                Undergrowth("bushes", "bush", 150.0 * undergrowth, patch=8.0, cover=0.35),
                Undergrowth("ferns", "fern", 500.0 * undergrowth, patch=7.0, cover=0.35, wet=0.8),
                Undergrowth("grass", "grass", 1500.0 * undergrowth, patch=4.0, cover=0.5),
            ],
            DistantLightCfg(intensity=2600.0, color=(1.0, 0.93, 0.82)),
            DomeLightCfg(intensity=900.0, color=(0.72, 0.82, 1.0)),
            places,
        )

    def shape(self, relief: Relief, rng: np.random.Generator) -> tuple[Relief, dict[str, np.ndarray]]:
        """Change the ground of this kind of scene, which is natural ground by default.

        Args:
            relief: Natural ground.
            rng: Generator of all random numbers.

        Returns:
            The ground, and maps in [0, 1]: ``open`` where no trees stand, ``trodden`` where nothing grows.
        """
        return relief, {}

    def generate(self, rng: np.random.Generator) -> TerrainInstance:
        # the scene's generator seeds the relief, so that one seed fixes everything
        cfg = ReliefCfg(**{**self.relief.__dict__, "seed": int(rng.integers(1 << 31))})
        relief, maps = self.shape(make_relief(cfg), rng)
        heights, cell = relief.heights, relief.cell
        nothing = np.zeros((2, 2), dtype=np.float32)
        shapes = {"slope": slope(heights, cell), "aspect": aspect(heights, cell)}
        maps = {**shapes, "moisture": moisture(heights, cell), "open": nothing, **maps}
        lower = (-0.5 * self.size[0], -0.5 * self.size[1])
        terrain = TerrainInstance(Ground(heights, lower, cell), tags=("ground", "forest floor"), maps=maps)
        terrain.colors = ground_colors(maps, heights.shape, self.size, int(rng.integers(1 << 31)))
        return terrain

    def survey(self, terrain: TerrainInstance) -> None:
        ground = terrain.ground
        terrain.maps["traversability"] = traversability(
            ground.heights, ground.cell, footprints(terrain), ROBOT_RADIUS, MAX_SLOPE, MAX_STEP
        )


class ClearingSpec(ForestSpec):
    """Level clearing in the forest, as wide as half of the shorter side; arguments are those of the forest."""

    def shape(self, relief: Relief, rng: np.random.Generator) -> tuple[Relief, dict[str, np.ndarray]]:
        radius = 0.25 * min(self.size)
        centre = rng.uniform(-0.05, 0.05, 2) * np.array(self.size)
        x, y = relief.axes
        level = flatten_disc(relief, (float(centre[0]), float(centre[1])), 0.75 * radius, 0.5 * radius)
        away = np.hypot(x - centre[0], y - centre[1])
        # the edge of the trees is wavy, or the clearing would look cut out
        wavy = radius * (1.0 + 0.12 * np.sin(3.0 * np.arctan2(y - centre[1], x - centre[0]) + rng.uniform(0.0, 6.0)))
        return level, {"open": (away < wavy).astype(np.float32)}


class PathSpec(ForestSpec):
    """Trodden path through the forest, along x; arguments are those of the forest."""

    width = 1.6
    """Width of the path [m]."""

    def shape(self, relief: Relief, rng: np.random.Generator) -> tuple[Relief, dict[str, np.ndarray]]:
        line = _winding(self.size, 0.16 * self.size[1], rng)
        away = _distance(relief, line)
        maps = {
            "open": (away < 0.5 * self.width + 0.5).astype(np.float32),
            "trodden": np.clip((0.5 * self.width + 0.3 - away) / 0.4, 0.0, 1.0).astype(np.float32),
        }
        return carve_path(relief, line, self.width, 1.0), maps


class RavineSpec(ForestSpec):
    """Steep ravine along x, 4 m deep unless the field is narrow; arguments are those of the forest."""

    def shape(self, relief: Relief, rng: np.random.Generator) -> tuple[Relief, dict[str, np.ndarray]]:
        width = min(14.0, 0.5 * self.size[1])
        line = _winding(self.size, 0.12 * self.size[1], rng, beyond=width)
        carved = carve_ravine(relief, line, 0.32 * width, width)
        away = _distance(relief, line)
        return carved, {"open": (away < 0.2 * width).astype(np.float32)}


def _winding(size: tuple[float, float], swing: float, rng: np.random.Generator, beyond: float = 2.0) -> np.ndarray:
    """Winding line along x, from edge to edge and ``beyond`` [m], ``(K, 2)``."""
    x = np.linspace(-0.5 * size[0] - beyond, 0.5 * size[0] + beyond, max(6, round(size[0] / 6.0)))
    knots = rng.normal(0.0, 1.0, len(x) + 4)
    y = np.convolve(knots, np.ones(5) / 5.0, mode="valid")
    return np.column_stack([x, swing * (y - y.mean()) / max(np.abs(y - y.mean()).max(), 1.0e-9)])


def _distance(relief: Relief, line: np.ndarray) -> np.ndarray:
    """Distance of each vertex from a line [m]."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(0.0, way[-1], 0.1)
    dense = np.column_stack([np.interp(at, way, c) for c in line.T])
    x, y = np.broadcast_arrays(*relief.axes)
    away, _ = cKDTree(dense).query(np.stack([x, y], axis=-1), workers=-1)
    return np.asarray(away)
