# SPDX-License-Identifier: Apache-2.0
"""Small wood of a few prototypes, for the tests of scene specifications and pictures."""

from __future__ import annotations

import math

import numpy as np

from stripe_newton.sim import DistantLightCfg, DomeLightCfg
from stripe_newton.specifications import (
    AssetSpec,
    Collider,
    ConeMesh,
    DynamicMesh,
    MeshPart,
    SceneSpec,
    SphereMesh,
    TerrainInstance,
)
from stripe_newton.terrains import Ground


def tree() -> DynamicMesh:
    trunk, crown = ConeMesh("trunk", (0.25, 6.0)).parts()[0], SphereMesh("crown", (1.5,)).parts()[0]
    leaves = MeshPart("leaves", crown.vertices + [0, 0, 3.5], crown.faces, (0.05, 0.2, 0.03), double_sided=True)
    bark = MeshPart("bark", trunk.vertices, trunk.faces, (0.1, 0.06, 0.04))
    return DynamicMesh("tree", [bark, leaves], [Collider("capsule", (0.25, 1.5), (0.0, 0.0, 1.75))])


class Scattered(AssetSpec):
    def __init__(self, name, mesh, count):
        super().__init__(name)
        self.mesh, self.count = mesh, count

    def generate(self, terrain, rng):
        places = rng.uniform(-0.48, 0.48, (self.count, 2)) * terrain.size
        heights = terrain.ground.height_at(*places.T)
        for index, (place, height) in enumerate(zip(places, heights, strict=True)):
            half = rng.uniform(-1.5, 1.5)
            turn = (0.0, 0.0, math.sin(half), math.cos(half))
            yield self.create_instance(f"a{index}", self.mesh, (*place, height), turn, rng.uniform(0.7, 1.3))


class SmallWood(SceneSpec):
    def __init__(self, size=(60.0, 40.0), density=None, count=100):
        if count < 0:
            raise ValueError(f"count is {count}, must be 0 or more")
        if density is not None:
            count = round(density * size[0] * size[1] / 1.0e4)
        ball = SphereMesh("stone", (0.3,), color=(0.3, 0.3, 0.32))
        palette = [Scattered("trees", tree(), count), Scattered("stones", ball, count)]
        super().__init__(size, palette, DistantLightCfg(), DomeLightCfg())

    def generate(self, rng):
        x, y = np.meshgrid(*(np.linspace(-0.5 * s, 0.5 * s, round(s) + 1) for s in self.size))
        heights = np.sin(0.2 * x + rng.uniform(0.0, 6.0)) * np.cos(0.15 * y)
        lower = (-0.5 * self.size[0], -0.5 * self.size[1])
        slope = np.arctan(np.hypot(*np.gradient(heights)))
        maps = {"slope": slope, "moisture": np.clip(0.5 - 0.5 * heights, 0.0, 1.0), "even": np.zeros((2, 2))}
        colors = np.where(x[..., None] < 0.0, [0.3, 0.1, 0.05], [0.05, 0.2, 0.05])
        return TerrainInstance(Ground(heights, lower, (1.0, 1.0)), colors=colors, maps=maps)


class FixedWood(SmallWood):
    def __init__(self, size=(20.0, 20.0)):
        super().__init__(size, count=10)


class NeedsNumber(SmallWood):
    def __init__(self, number, size=(20.0, 20.0)):
        super().__init__(size, count=number)
