# SPDX-License-Identifier: Apache-2.0
"""Terrain instance: the ground of a generated scene, with its colours, maps and placed assets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stripe_newton.terrains import Ground

from .asset_instance import AssetInstance
from .asset_mesh import MeshPart

__all__ = ["TerrainInstance"]


@dataclass(eq=False)
class TerrainInstance:
    """The ground of a scene: a height field, and visible surfaces on it.

    Attributes:
        ground: The height field, with which robots collide.
        origin: Start of a robot [m]. None: on the ground in the middle.
        parts: Further visible surfaces without collider, with their semantic labels, such as the water of a brook.
        tags: Semantic labels of the height field.
        color: Linear RGB of the height field.
        static_friction: Static friction of the ground.
        dynamic_friction: Dynamic friction of the ground.
        colors: Linear RGB at each height, ``(nrow, ncol, 3)``. None: ``color`` everywhere.
        maps: Properties of the ground by name, each ``(rows, cols)`` over its extent, rows along y: ``slope`` [rad],
            ``moisture`` and ``traversability`` in [0, 1], or others.
        max_init_level: Highest level on which environments start, for a ground with tiles. None: any.
        placed: Assets placed so far, by the name of their specification.
    """

    ground: Ground
    origin: tuple[float, float, float] | None = None
    parts: Sequence[tuple[MeshPart, Sequence[str]]] = ()
    tags: Sequence[str] = ("terrain",)
    color: tuple[float, float, float] = (0.16, 0.12, 0.07)
    static_friction: float = 1.0
    dynamic_friction: float = 1.0
    colors: np.ndarray | None = None
    maps: dict[str, np.ndarray] = field(default_factory=dict)
    max_init_level: int | None = None
    placed: dict[str, list[AssetInstance]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = (*self.ground.heights.shape, 3)
        if self.colors is not None and np.shape(self.colors) != shape:
            raise ValueError(f"terrain: colors are {np.shape(self.colors)}, must be {shape}, one for each height")
        if self.origin is None:
            x, y = self.ground.middle
            self.origin = (x, y, float(self.ground.height_at(np.array(x), np.array(y))))

    @property
    def size(self) -> tuple[float, float]:
        """Extent in x and y [m]."""
        return self.ground.size
