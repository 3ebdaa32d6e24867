# SPDX-License-Identifier: Apache-2.0
"""Scene assets: the assets of a scene, as its sensors and terrains see them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from .articulation import Articulation
from .asset_base import AssetBase
from .rigid_object import RigidObject
from .terrain_base import TerrainBase

__all__ = ["SceneAssets"]


class SceneAssets(Protocol):
    """The part of :class:`stripe_newton.scene.SceneContents` that has the assets.

    Sensors are below scenes in the layout of the package, and know this part of them alone.
    """

    @property
    def assets(self) -> Sequence[AssetBase]:
        """Every asset in order of construction."""

    @property
    def articulations(self) -> Mapping[str, Articulation]:
        """Articulations by name."""

    @property
    def rigid_objects(self) -> Mapping[str, RigidObject]:
        """Rigid bodies by name."""

    @property
    def extras(self) -> Mapping[str, AssetBase]:
        """Static assets by name."""

    @property
    def terrain(self) -> TerrainBase | None:
        """Ground of the environments, if the scene names it."""
