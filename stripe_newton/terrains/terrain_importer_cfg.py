# SPDX-License-Identifier: Apache-2.0
"""Config of what the environments stand on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from stripe_newton.assets import TerrainBaseCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.sim import PreviewSurfaceCfg, RigidBodyMaterialCfg

from .terrain_generator_cfg import TerrainGeneratorCfg
from .terrain_importer import TerrainImporter

__all__ = ["TerrainImporterCfg"]


@configclass
class TerrainImporterCfg(TerrainBaseCfg):
    """The ground that all environments share: a plane, a grid of generated tiles, or a file."""

    class_type: Callable[..., Any] = TerrainImporter
    """Class that the scene makes of this config."""
    prim_path: str = MISSING
    """Where it stands in the stage, such as ``/World/ground``; not in an environment."""
    terrain_type: str = "generator"
    """``"plane"``, ``"generator"``, ``"usd"`` for a USD or mesh file, or ``"stage"`` for the height field of an
    exported scene that stands at ``prim_path`` already."""
    terrain_generator: TerrainGeneratorCfg | None = None
    """The tiles, for ``"generator"``."""
    usd_path: str | None = None
    """For ``"usd"``: a USD file, or a mesh file (OBJ, STL, PLY, GLB, OFF) in metres with z up."""
    horizontal_scale: float = 0.1
    """For ``"usd"``: distance between two heights that are taken from the file's surface [m]."""
    num_envs: int | None = None
    """Accepted for compatibility: the scene knows."""
    env_spacing: float | None = None
    """Distance between environments [m] where the ground has no tiles; ``None``: that of the scene."""
    use_terrain_origins: bool = True
    """Whether environments start on the tiles rather than on the grid of ``env_spacing``."""
    max_init_terrain_level: int | None = None
    """Highest level on which environments start; ``None``: any."""
    physics_material: RigidBodyMaterialCfg | None = RigidBodyMaterialCfg()
    """Friction and restitution; ``None``: those of the simulation."""
    visual_material: PreviewSurfaceCfg | None = None
    """Colour of the ground."""
    collision_group: int = -1
    """Accepted for compatibility: all environments collide with the ground."""
    debug_vis: bool = False
    """Accepted for compatibility."""

    def problems(self) -> Iterator[tuple[str, str]]:
        kinds = ("plane", "generator", "usd", "stage")
        if self.terrain_type not in kinds:
            yield "terrain_type", f"is '{self.terrain_type}', must be one of {', '.join(map(repr, kinds))}"
        if self.terrain_type == "generator" and self.terrain_generator is None:
            yield "terrain_generator", "is None; terrain_type 'generator' needs a TerrainGeneratorCfg"
        if self.terrain_type == "usd":
            if self.usd_path is None:
                yield "usd_path", "is None; terrain_type 'usd' needs a file"
            elif not Path(self.usd_path).expanduser().is_file():
                yield "usd_path", f"'{self.usd_path}' does not exist; give the path of a file"
        if not (math.isfinite(self.horizontal_scale) and self.horizontal_scale > 0.0):
            yield "horizontal_scale", f"is {self.horizontal_scale}, must be positive [m]"
        if self.env_spacing is not None and not (math.isfinite(self.env_spacing) and self.env_spacing >= 0.0):
            yield "env_spacing", f"is {self.env_spacing}, must be 0 or more [m] or None"
        if self.max_init_terrain_level is not None and self.max_init_terrain_level < 0:
            yield "max_init_terrain_level", f"is {self.max_init_terrain_level}, must be 0 or more, or None"
        if self.prim_path is not MISSING and self.prim_path.startswith(("{ENV_REGEX_NS}", "/World/envs")):
            yield "prim_path", f"is '{self.prim_path}'; the ground is shared, put it outside of the environments"
