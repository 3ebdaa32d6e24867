# SPDX-License-Identifier: Apache-2.0
"""Scene of the rubble: a few streets of a town of which an earthquake left heaps."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from stripe_newton.sim import DistantLightCfg, DomeLightCfg
from stripe_newton.specifications import Places, SceneSpec, TerrainInstance
from stripe_newton.specifications.places import walkable
from stripe_newton.terrains import Ground

from .pieces import Bars, Debris, Loose, Standing
from .relief import RubbleTerrain, blocks, colors, heap_up, roughen, street_map

__all__ = ["PLACES", "RubbleSpec"]

PLACES: Mapping[str, Places] = {"init_pos": Places(radius=0.7), "target": Places(radius=0.6)}
"""Places where robots start and places to which they are sent."""
ROBOT_RADIUS, MAX_SLOPE = 0.4, math.radians(35.0)
"""Robot for which the map ``walkable`` is made: radius [m] and steepest slope [rad]."""


class RubbleSpec(SceneSpec):
    """Collapsed buildings between streets.

    All colliders of the pieces are capsules, so that collider slots can hold them. At the default density, 24 slots
    with a reach of 0.9 m around the root suffice on ground that can be walked on, 32 anywhere on the heaps.

    Args:
        size: Extent in x and y [m].
        density: Slabs and beams per hectare.
        count: Slabs and beams in all; overrides ``density``.
        resolution: Spacing of the heights [m].
        height: Approximate height of the heaps [m].
        rough: Height of lumps on them [m].
        walls: Remnants of walls per hectare; ``columns`` likewise.
        bricks: Bricks for each slab or beam; ``chunks`` of concrete, ``pipes`` and ``bars`` likewise.
        clutter: Factor on bricks, lumps, pipes, bars and debris.
        places: Places for robots to find.
    """

    def __init__(
        self,
        size: tuple[float, float] = (40.0, 40.0),
        density: float = 1100.0,
        count: int | None = None,
        *,
        resolution: float = 0.2,
        height: float = 3.0,
        rough: float = 0.06,
        walls: float = 30.0,
        columns: float = 45.0,
        bricks: float = 1.8,
        chunks: float = 1.6,
        pipes: float = 0.15,
        bars: float = 0.7,
        clutter: float = 1.0,
        places: Mapping[str, Places] = PLACES,
    ):
        for name, value in {"density": density, "count": count or 0, "height": height, "rough": rough}.items():
            if not 0.0 <= value < math.inf:
                raise ValueError(f"RubbleSpec: {name} is {value}, must be 0 or more")
        if min(clutter, bricks, chunks, pipes, bars, walls, columns) < 0.0:
            raise ValueError("RubbleSpec: walls, columns, bricks, chunks, pipes, bars and clutter must be 0 or more")
        if not 0.0 < resolution <= 0.25 * min(size):
            raise ValueError(f"RubbleSpec: resolution is {resolution}, must be above 0 and at most a quarter of {size}")
        self.resolution, self.height, self.rough = resolution, height, rough
        main = round(density * size[0] * size[1] / 1.0e4) if count is None else count
        slabs, small = round(0.74 * main), clutter * main
        super().__init__(
            size,
            [
                Standing("walls", "wall", walls),
                Standing("columns", "column", columns),
                Loose("slabs", "slab", count=slabs, apart=1.0, raised=0.3, stray=0.02),
                Loose("beams", "beam", count=main - slabs, apart=1.0, raised=0.25, stray=0.03),
                Loose("pipes", "pipe", count=round(pipes * small), apart=1.5, raised=0.5, stray=0.05),
                Bars("bars", ("slabs", "beams"), bars * clutter),
                Loose("bricks", "brick", count=round(bricks * small), apart=0.35, stray=0.12, scale=(0.95, 1.05)),
                Loose("chunks", "chunk", count=round(chunks * small), apart=0.35, stray=0.08, scale=(0.7, 1.2)),
                Debris("debris", 9000.0 * clutter),
            ],
            DistantLightCfg(intensity=2500.0, color=(1.0, 0.95, 0.86)),
            DomeLightCfg(intensity=950.0, color=(0.78, 0.85, 1.0)),
            places,
        )

    def generate(self, rng: np.random.Generator) -> TerrainInstance:
        shape = [max(3, round(s / self.resolution) + 1) for s in self.size]
        x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(self.size, shape, strict=True))
        cell = float(x[1] - x[0]), float(y[1] - y[0])
        buildings = blocks(self.size, rng)
        street = street_map(*np.meshgrid(x, y), buildings)
        heights = roughen(heap_up(x, y, buildings, self.height, rng), street, cell[0], self.rough, rng)
        slope = np.arctan(np.hypot(*np.gradient(heights, cell[1], cell[0])))
        return RubbleTerrain(
            Ground(heights, (-0.5 * self.size[0], -0.5 * self.size[1]), cell),
            tags=("ground", "rubble"),
            color=(0.25, 0.235, 0.21),
            colors=colors(heights, street, cell[0], self.height, rng),
            maps={"slope": slope.astype(np.float32), "street": street.astype(np.float32)},
            buildings=buildings,
        )

    def survey(self, terrain: TerrainInstance) -> None:
        """Add the map ``walkable``: 1 where a robot can stand."""
        terrain.maps["walkable"] = walkable(terrain, ROBOT_RADIUS, MAX_SLOPE)[0].astype(np.float32)
