# SPDX-License-Identifier: Apache-2.0
"""Struct of the terrain in terms: the ground that heights are looked up in, as ``terrain``."""

from __future__ import annotations

from stripe_newton.fusion import StructRegistry

from .terrain_importer import TerrainImporter

__all__ = ["register_terrain_struct"]


def register_terrain_struct(structs: StructRegistry, terrain: object) -> None:
    """Let terms find the terrain of a scene, where it is one that heights can be looked up in."""
    if isinstance(terrain, TerrainImporter):
        structs.provide(terrain.struct, "terrain")
