# SPDX-License-Identifier: Apache-2.0
"""The ground of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stripe_newton.terrains import Ground

from .asset import AssetInstance
from .mesh import MeshPart

__all__ = ["TerrainInstance"]


@dataclass(eq=False)
class TerrainInstance:
    """What a scene stands on: a height field, and surfaces that are seen on it.

    Attributes:
        ground: The height field, which is touched.
        origin: Where a robot starts [m]; on the ground in the middle where None.
        parts: Further surfaces with their semantic labels, seen and not touched, such as the water of a brook.
        tags: Semantic labels of the height field.
        color: Linear RGB of the height field.
        static_friction: Of the ground, as ``dynamic_friction`` is.
        placed: Everything that stands on it so far, by the name of its spec.
    """

    ground: Ground
    origin: tuple[float, float, float] | None = None
    parts: Sequence[tuple[MeshPart, Sequence[str]]] = ()
    tags: Sequence[str] = ("terrain",)
    color: tuple[float, float, float] = (0.16, 0.12, 0.07)
    static_friction: float = 1.0
    dynamic_friction: float = 1.0
    placed: dict[str, list[AssetInstance]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.origin is None:
            x, y = self.ground.middle
            self.origin = (x, y, float(self.ground.height_at(np.array(x), np.array(y))))

    @property
    def size(self) -> tuple[float, float]:
        """Extent in x and y [m]."""
        return self.ground.size
