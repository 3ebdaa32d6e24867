# SPDX-License-Identifier: Apache-2.0
"""Terrain base: the ground of a scene, as the rest of the scene sees it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

import newton
import warp as wp
from pxr import Usd

from stripe_kernels.terrain import TerrainData
from stripe_newton.configclass import MISSING, configclass

from .asset_base import AssetBase

if TYPE_CHECKING:
    import torch

    from stripe_newton.terrains.ground import Ground
    from stripe_newton.terrains.terrain_generator import TerrainGenerator

__all__ = ["GroundAsset", "TerrainBase", "TerrainBaseCfg"]


@configclass
class TerrainBaseCfg:
    """Base of the terrain configs: a field of the scene's config of this type becomes ``scene.terrain``."""

    MAY_BE_NONE: ClassVar[bool] = True

    class_type: Callable[..., TerrainBase] | None = None
    """Class that the scene makes of this config."""
    prim_path: str = MISSING
    """Prim path, such as ``/World/ground``; not in an environment."""


class TerrainBase:
    """Base of ``scene.terrain``, the ground of the environments.

    The defaults are those of a ground that is nothing but a prim of the stage, such as a plane.
    """

    path: str
    """Prim path."""
    struct: TerrainData | None = None
    """The ground as terms and sensors read it; None if it offers nothing to them."""
    ground: Ground | None = None
    """The height field on the host; None if there is none."""
    generator: TerrainGenerator | None = None
    """The generator of its tiles; None if it has none."""
    flat_patches: Mapping[str, torch.Tensor] = MappingProxyType({})
    """Flat patches by name [m], shape ``(levels, types, num_patches, 3)``."""

    labels: Mapping[str, str] = MappingProxyType({})
    """Semantic labels of prims that are parts of it, by path."""

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name; none by default."""
        return {}

    def names_of(self, kind: str) -> list[str] | None:
        """Names of joints or bodies, as of other assets: None, as a ground has none."""
        return None

    def add_to(self, static: newton.ModelBuilder) -> None:
        """Add shapes that are not in the stage to what all environments share."""

    def author(self, stage: Usd.Stage) -> None:
        """Write what is not in the stage of the scene into ``stage``, a copy of it that is exported."""


class GroundAsset(AssetBase, TerrainBase):
    """A static asset that is the terrain of a scene."""
