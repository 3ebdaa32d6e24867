# SPDX-License-Identifier: Apache-2.0
"""Struct of the terrain in terms: the ground that heights are looked up in, as ``terrain``."""

from __future__ import annotations

from stripe_newton.assets.terrain_base import TerrainBase
from stripe_newton.fusion import StructRegistry

__all__ = ["register_terrain_struct"]


def register_terrain_struct(structs: StructRegistry, terrain: TerrainBase | None) -> None:
    """Register the struct of a scene's terrain, if heights can be looked up in it."""
    if terrain is not None and terrain.struct is not None:
        structs.provide(terrain.struct, "terrain")
