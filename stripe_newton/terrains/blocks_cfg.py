# SPDX-License-Identifier: Apache-2.0
"""Configs of the sub-terrains that Isaac Lab makes as meshes, under its names; here they are height fields too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stripe_newton.configclass import MISSING, configclass

from . import blocks, height_fields
from .sub_terrain_cfg import Range, SubTerrainBaseCfg

__all__ = [
    "MeshBoxTerrainCfg",
    "MeshGapTerrainCfg",
    "MeshInvertedPyramidStairsTerrainCfg",
    "MeshPitTerrainCfg",
    "MeshPlaneTerrainCfg",
    "MeshPyramidStairsTerrainCfg",
    "MeshRailsTerrainCfg",
    "MeshRandomGridTerrainCfg",
    "MeshStarTerrainCfg",
]


@configclass
class MeshPlaneTerrainCfg(SubTerrainBaseCfg):
    """Level ground."""

    function: Callable[..., Any] = blocks.flat_terrain
    """Function that makes the heights."""


@configclass
class MeshPyramidStairsTerrainCfg(SubTerrainBaseCfg):
    """Stairs on four sides, up to a platform."""

    function: Callable[..., Any] = height_fields.pyramid_stairs_terrain
    """Function that makes the heights."""
    border_width: float = 0.0
    """Level ground about the stairs [m]."""
    step_height_range: Range = MISSING
    """Height of a step at difficulty 0 and 1 [m]."""
    step_width: float = MISSING
    """Depth of a step [m]."""
    platform_width: float = 1.0
    """Least side of the platform [m]."""
    inverted: bool = False
    """Down instead of up."""


@configclass
class MeshInvertedPyramidStairsTerrainCfg(MeshPyramidStairsTerrainCfg):
    """Stairs on four sides, down to a platform."""

    inverted: bool = True
    """Down instead of up."""


@configclass
class MeshRandomGridTerrainCfg(SubTerrainBaseCfg):
    """Square blocks of random heights."""

    function: Callable[..., Any] = blocks.random_grid_terrain
    """Function that makes the heights."""
    grid_width: float = MISSING
    """Side of a block [m]."""
    grid_height_range: Range = MISSING
    """Greatest height at difficulty 0 and 1 [m]; blocks are higher or lower by up to this."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""
    holes: bool = False
    """Leave out the blocks that are neither in the platform's rows nor in its columns."""
    holes_depth: float = 1.0
    """Depth of what is left out [m]."""


@configclass
class MeshRailsTerrainCfg(SubTerrainBaseCfg):
    """Two square rails about the middle."""

    function: Callable[..., Any] = blocks.rails_terrain
    """Function that makes the heights."""
    rail_thickness_range: Range = MISSING
    """Thickness of the rails [m], the greater at difficulty 0; its top is whole cells wide."""
    rail_height_range: Range = MISSING
    """Height of the rails at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""


@configclass
class MeshPitTerrainCfg(SubTerrainBaseCfg):
    """A square pit to climb out of."""

    function: Callable[..., Any] = blocks.pit_terrain
    """Function that makes the heights."""
    pit_depth_range: Range = MISSING
    """Depth at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the bottom [m]."""
    double_pit: bool = False
    """With a step of one metre half way up."""


@configclass
class MeshBoxTerrainCfg(SubTerrainBaseCfg):
    """A square block to climb down from."""

    function: Callable[..., Any] = blocks.box_terrain
    """Function that makes the heights."""
    box_height_range: Range = MISSING
    """Height at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the top [m]."""
    double_box: bool = False
    """With a step of one metre half way down."""


@configclass
class MeshGapTerrainCfg(SubTerrainBaseCfg):
    """A ditch about the platform."""

    function: Callable[..., Any] = blocks.gap_terrain
    """Function that makes the heights."""
    gap_width_range: Range = MISSING
    """Width of the ditch at difficulty 0 and 1 [m], rounded to cells, at least two."""
    platform_width: float = 1.0
    """Side of the platform [m]."""
    depth: float = 1.0
    """Depth of the ditch [m]."""


@configclass
class MeshStarTerrainCfg(SubTerrainBaseCfg):
    """Beams that lead from the platform over a pit."""

    function: Callable[..., Any] = blocks.star_terrain
    """Function that makes the heights."""
    num_bars: int = MISSING
    """Beams, at equal angles."""
    bar_width_range: Range = MISSING
    """Width of the beams [m], the greater at difficulty 0."""
    bar_height_range: Range = MISSING
    """Height of the beams above the pit at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the platform [m]."""
    border_width: float = 0.5
    """Level ground about the pit, where the beams end [m]."""
