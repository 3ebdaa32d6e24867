# SPDX-License-Identifier: Apache-2.0
"""Terrain importer: the ground of a scene (plane, tiles or file), where environments start on it, and their levels."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import newton
import numpy as np
import torch
import warp as wp
from pxr import Usd, UsdGeom

from stripe_kernels.terrain import TerrainData
from stripe_newton.assets import TerrainBase, TerrainBaseCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.input_files import why_no_file
from stripe_newton.sim import GroundPlaneCfg, PreviewSurfaceCfg, RigidBodyMaterialCfg
from stripe_newton.sim.scene_context import authored_path, current_scene

from .env_origins import grid_origins, tile_of
from .ground import Ground
from .ground_usd import author_ground, ground_prims, placement, read_ground
from .terrain_generator import TerrainGenerator, TerrainGeneratorCfg

__all__ = ["TerrainImporter", "TerrainImporterCfg", "found_terrain"]

_FAR = 1.0e9
"""Half the extent of a plane, for lookups of its height [m]."""


class TerrainImporter(TerrainBase):
    """The ground of the scene under construction: an endless plane, or one height field for all environments.

    Its constructor spawns it and decides where the environments start. On tiles, environment ``i`` is of type
    ``i % num_cols`` and starts on a random level; both depend only on its index.

    Attributes:
        cfg: The config.
        ground: The height field on the host; None for a plane.
        generator: The generator of the tiles; None for a plane or a file.
        terrain_origins: Origins of the tiles [m], shape ``(levels, types, 3)``; None without tiles.
        terrain_levels: Level of each environment, int32, shape ``(num_envs,)``.
        terrain_types: Type of each environment, int32, shape ``(num_envs,)``.
        env_origins: Origins of the environments [m], shape ``(num_envs, 3)``: the tensor of the scene.
        flat_patches: Flat patches by name [m], shape ``(levels, types, num_patches, 3)``.
        struct: All of it as terms read it, on the same memory.
    """

    struct: TerrainData

    def __init__(self, cfg: TerrainImporterCfg):
        cfg.validate()
        self.cfg = cfg = cfg.copy()
        self._scene = scene = current_scene()
        if scene.built or scene.terrain is not None:
            raise RuntimeError(
                f"'{cfg.prim_path}' comes after the scene was built: create it before"
                if scene.built
                else f"'{cfg.prim_path}': the scene has a terrain at '{scene.terrain.cfg.prim_path}' already"
            )
        self.generator: TerrainGenerator | None = None
        self.path = authored_path(cfg.prim_path)
        self.ground = self._make_ground()
        self.device, self.num_envs = scene.device, scene.num_envs
        if cfg.num_envs not in (None, self.num_envs):
            warnings.warn(
                f"TerrainImporterCfg.num_envs is {cfg.num_envs}, the scene has {self.num_envs} environments; "
                "the scene's number is used",
                stacklevel=2,
            )
        self.env_origins: torch.Tensor = scene.env_origins
        self._place()
        self._fill_struct()
        scene.terrain = self

    def _make_ground(self) -> Ground | None:
        """Spawn the ground; the height field, or None for a plane."""
        cfg, stage = self.cfg, self._scene.stage
        if cfg.terrain_type == "stage":
            prim = stage.GetPrimAtPath(f"{self.path}/terrain")
            if not prim or prim not in ground_prims(stage):
                raise ValueError(f"'{cfg.prim_path}': the stage holds no height field there that a scene exported")
            return read_ground(prim)
        if cfg.terrain_type == "plane":
            material = cfg.physics_material or self._scene.sim.cfg.physics_material
            plane = GroundPlaneCfg(physics_material=material)
            if cfg.visual_material is not None:
                plane.color = cfg.visual_material.diffuse_color
            plane.func(cfg.prim_path, plane)
            return None  # the plane is read from the stage as any other collider
        UsdGeom.Xform.Define(stage, self.path)
        if cfg.terrain_type == "usd":
            from .ground_files import ground_from_file  # imports trimesh, which only files need

            return ground_from_file(str(cfg.usd_path), cfg.horizontal_scale, self._scene.device)
        self.generator = TerrainGenerator(cfg.terrain_generator or TerrainGeneratorCfg())
        return self.generator.ground

    def _place(self) -> None:
        """Set levels, types and origins of the environments."""
        ground = self.ground
        origins = ground.origins if ground is not None else None
        levels, types = np.zeros((2, self.num_envs), dtype=np.int32)  # without tiles: all on level 0 of type 0
        self.terrain_origins = None
        if ground is not None and origins is not None:
            self.terrain_origins = torch.tensor(origins, dtype=torch.float32, device=self.device)
            most = self.cfg.max_init_terrain_level
            levels, types = tile_of(self.num_envs, origins.shape[:2], most, ground.seed)
        own = self._origins_of(ground, levels, types)
        self.terrain_levels = torch.tensor(levels, device=self.device)
        self.terrain_types = torch.tensor(types, device=self.device)
        # In place: assets and sensors hold views of the scene's tensor.
        self.env_origins.copy_(torch.tensor(own, dtype=torch.float32))

    def _origins_of(self, ground: Ground | None, levels: np.ndarray, types: np.ndarray) -> np.ndarray:
        """Origins of environments with the given levels and types on a ground [m], shape ``(num_envs, 3)``."""
        if ground is not None and ground.origins is not None and self.cfg.use_terrain_origins:
            return np.asarray(ground.origins[levels, types])
        spacing = self._scene.cfg.env_spacing if self.cfg.env_spacing is None else self.cfg.env_spacing
        return grid_origins(self.num_envs, spacing, ground)

    def _fill_struct(self) -> None:
        """Fill the struct of terms. Its arrays are views of the tensors above, so that a change of one is in both."""
        ground, device = self.ground, self.device
        data = TerrainData()
        # A plane is a field of one huge cell at height 0, so that terms need no case of their own for it.
        heights = np.zeros((2, 2), dtype=np.float32)
        lower, cell, tile = (-_FAR, -_FAR), (2 * _FAR, 2 * _FAR), (0.0, 0.0)
        if ground is not None:
            heights, lower, cell, tile = ground.heights, ground.lower, ground.cell, ground.tile
        data.heights = wp.array(heights, dtype=float, device=device)
        data.lower, data.cell, data.tile = wp.vec2(*lower), wp.vec2(*cell), wp.vec2(*tile)
        tiles = self.terrain_origins if self.cfg.use_terrain_origins else None
        data.origins = wp.zeros((0, 0), dtype=wp.vec3, device=device)
        if tiles is not None:
            data.origins = wp.from_torch(tiles, dtype=wp.vec3)
        patches = ground.patches if ground is not None else {}
        self.flat_patches = {
            name: torch.tensor(points, dtype=torch.float32, device=device) for name, points in patches.items()
        }
        for name in ("init_pos", "target"):
            points = self.flat_patches.get(name)
            # An array without patches, not None: a struct of Warp needs one of each.
            empty = points is None or tiles is None
            array = wp.zeros((1, 1, 0), dtype=wp.vec3, device=device) if empty else wp.from_torch(points, dtype=wp.vec3)
            setattr(data, name, array)
        data.level, data.kind = wp.from_torch(self.terrain_levels), wp.from_torch(self.terrain_types)
        data.env_origin = wp.from_torch(self.env_origins, dtype=wp.vec3)
        self.struct = data

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that keep state from step to step, by name."""
        return {"level": self.struct.level, "env_origin": self.struct.env_origin}

    # -- called by the scene

    def add_to(self, static: newton.ModelBuilder) -> None:
        """Add the height field to the builder of what all environments share.

        Raises:
            ValueError: if a collider lies at or below its path already, such as a ground plane.
        """
        if self.ground is None:
            return
        solid = int(newton.ShapeFlags.COLLIDE_SHAPES)
        shapes = zip(static.shape_label, static.shape_flags, strict=True)
        # A plane of the scene's config at the height of the edges would lie above every hollow.
        there = [label for label, flags in shapes if f"{label}/".startswith(f"{self.path}/") and flags & solid]
        if there:
            raise ValueError(
                f"'{self.cfg.prim_path}': the ground has a collider '{there[0]}' beside the terrain, which would fill "
                "its pits; leave the other one out, such as by ground=None in the scene's config"
            )
        shape = static.default_shape_cfg.copy()
        if self.cfg.physics_material is not None:
            shape.mu = self.cfg.physics_material.dynamic_friction
            shape.restitution = self.cfg.physics_material.restitution
        color = None
        if self.cfg.visual_material is not None:
            color = newton.utils.color_linear_to_srgb(self.cfg.visual_material.diffuse_color)
        static.add_shape_heightfield(
            xform=wp.transform(wp.vec3(*self.ground.middle, 0.0), wp.quat_identity()),
            heightfield=self.ground.source,
            cfg=shape,
            color=color,
            label=f"{self.path}/terrain",
        )

    def author(self, stage: Usd.Stage) -> None:
        """Write the height field into ``stage`` as a mesh collider, which ``InteractiveScene.from_usd`` reads back."""
        if self.ground is None:
            return
        author_ground(
            stage,
            self.path,
            self.ground,
            use_terrain_origins=self.cfg.use_terrain_origins,
            max_init_terrain_level=self.cfg.max_init_terrain_level,
            physics_material=self.cfg.physics_material,
            visual_material=self.cfg.visual_material,
        )

    # -- replacing the ground

    def check(self, ground: Ground) -> None:
        """Check that another ground can replace the present one.

        Raises:
            ValueError: if its heights lie on another grid, or its numbers of tiles or patches differ.
        """
        mine, where = self.ground, f"'{self.cfg.prim_path}'"
        if mine is None:
            raise ValueError(f"{where}: is a plane, which no height field can replace")
        # Graphs hold the addresses of the arrays, so their shapes must stay.
        for name, what in (("heights", "heights"), ("origins", "origins of tiles")):
            here, new = (None if v is None else v.shape for v in (getattr(mine, name), getattr(ground, name)))
            if here != new:
                raise ValueError(f"{where}: the new ground has {what} of shape {new}, must be {here} as now")
        # These are numbers inside the struct of terms, which a graph has copied when it was recorded.
        for name in ("lower", "cell", "tile"):
            here, new = getattr(mine, name), getattr(ground, name)
            if not np.allclose(here, new, rtol=1.0e-5, atol=1.0e-6):
                raise ValueError(f"{where}: {name} of the new ground is {tuple(new)} m, must be {tuple(here)} m as now")
        here, new = ({name: points.shape for name, points in g.patches.items()} for g in (mine, ground))
        if here != new:
            raise ValueError(f"{where}: the new ground has the patches {new or 'none'}, must have {here or 'none'}")

    def replace(self, ground: Ground) -> None:
        """Replace the ground in place: graphs stay valid, environments keep their levels.

        The model and sensors have copies of their own: :meth:`InteractiveScene.regenerate` writes all of them.

        Raises:
            ValueError: see :meth:`check`.
        """
        self.check(ground)
        levels, types = self.terrain_levels.cpu().numpy(), self.terrain_types.cpu().numpy()
        own = self._origins_of(ground, levels, types)
        self.ground = ground
        # Everything is written into the arrays that are there: graphs hold their addresses.
        self.struct.heights.assign(ground.heights)
        if self.terrain_origins is not None:
            self.terrain_origins.copy_(torch.tensor(ground.origins, dtype=torch.float32))
        for name, points in self.flat_patches.items():
            points.copy_(torch.tensor(ground.patches[name], dtype=torch.float32))
        self.env_origins.copy_(torch.tensor(own, dtype=torch.float32))

    # -- levels

    def update_env_origins(self, env_ids: torch.Tensor, move_up: torch.Tensor, move_down: torch.Tensor) -> None:
        """Move environments to other levels of their type. After the last level comes a random one.

        Args:
            env_ids: Environments, shape ``(n,)``.
            move_up: Whether to move to a harder level, bool, shape ``(n,)``.
            move_down: Whether to move to an easier one, bool, shape ``(n,)``.
        """
        if self.terrain_origins is None or not self.cfg.use_terrain_origins:
            return
        ids = torch.as_tensor(env_ids, device=self.device).long()
        last = len(self.terrain_origins) - 1
        levels = self.terrain_levels[ids] + move_up.to(torch.int32) - move_down.to(torch.int32)
        # A robot that masters the last level goes on training on all of them, so that it forgets none.
        drawn = torch.randint_like(levels, last + 1)
        self.terrain_levels[ids] = torch.where(levels > last, drawn, levels.clip(min=0))
        self.env_origins[ids] = self.terrain_origins[self.terrain_levels[ids].long(), self.terrain_types[ids].long()]

    def height_at(self, positions: torch.Tensor) -> torch.Tensor:
        """Height of the ground at points of the world [m], shape ``(...)`` for points ``(..., 2)`` or ``(..., 3)``."""
        if self.ground is None:
            return torch.zeros_like(positions[..., 0])
        points = positions.detach().cpu().numpy()  # on the host: terms use terrain_height() of stripe_kernels
        found = self.ground.height_at(points[..., 0], points[..., 1])
        return torch.tensor(found, dtype=torch.float32, device=positions.device)


@configclass
class TerrainImporterCfg(TerrainBaseCfg):
    """The ground that all environments share: a plane, a grid of generated tiles, or a file."""

    class_type: type[TerrainImporter] = TerrainImporter
    """Class that the scene makes from this config."""
    prim_path: str = MISSING
    """Path in the stage, such as ``/World/ground``; not inside an environment."""
    terrain_type: str = "generator"
    """``"plane"``, ``"generator"``, ``"usd"`` for a USD or mesh file, or ``"stage"`` for the height field of an
    exported scene that is at ``prim_path`` already."""
    terrain_generator: TerrainGeneratorCfg | None = None
    """The tiles, for ``"generator"``."""
    usd_path: str | None = None
    """For ``"usd"``: a USD file, or a mesh file (OBJ, STL, PLY, GLB, OFF) in metres with z up."""
    horizontal_scale: float = 0.1
    """For ``"usd"``: distance between neighbouring heights that are sampled from the file's surface [m]."""
    num_envs: int | None = None
    """Number of environments. The scene's own number is used; a different one here is a warning."""
    env_spacing: float | None = None
    """Distance between environments [m] where the ground has no tiles. ``None``: that of the scene."""
    use_terrain_origins: bool = True
    """Whether environments start on the tiles rather than on the grid of ``env_spacing``."""
    max_init_terrain_level: int | None = None
    """Highest level on which environments start. ``None``: any."""
    physics_material: RigidBodyMaterialCfg | None = RigidBodyMaterialCfg()
    """Friction and restitution. ``None``: those of the simulation."""
    visual_material: PreviewSurfaceCfg | None = None
    """Colour of the ground."""
    collision_group: int = -1
    """Ignored: all environments collide with the ground."""
    debug_vis: bool = False
    """Ignored: no markers are drawn at the origins."""

    IGNORED: ClassVar[dict[str, str]] = {
        "collision_group": "all environments collide with the ground",
        "debug_vis": "no markers are drawn at the origins",
    }

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from self._source_problems()
        if not (math.isfinite(self.horizontal_scale) and self.horizontal_scale > 0.0):
            yield "horizontal_scale", f"is {self.horizontal_scale}, must be positive [m]"
        if self.env_spacing is not None and not (math.isfinite(self.env_spacing) and self.env_spacing >= 0.0):
            yield "env_spacing", f"is {self.env_spacing}, must be 0 or more [m] or None"
        if self.max_init_terrain_level is not None and self.max_init_terrain_level < 0:
            yield "max_init_terrain_level", f"is {self.max_init_terrain_level}, must be 0 or more, or None"
        if self.prim_path is not MISSING and self.prim_path.startswith(("{ENV_REGEX_NS}", "/World/envs")):
            yield "prim_path", f"is '{self.prim_path}'; the ground is shared, put it outside of the environments"

    def _source_problems(self) -> Iterator[tuple[str, str]]:
        kinds = ("plane", "generator", "usd", "stage")
        if self.terrain_type not in kinds:
            yield "terrain_type", f"is '{self.terrain_type}', must be one of {', '.join(map(repr, kinds))}"
        if self.terrain_type == "generator" and self.terrain_generator is None:
            yield "terrain_generator", "is None; terrain_type 'generator' needs a TerrainGeneratorCfg"
        if self.terrain_type == "usd":
            if self.usd_path is None:
                yield "usd_path", "is None; terrain_type 'usd' needs a file"
            elif problem := why_no_file(Path(self.usd_path).expanduser()):
                yield "usd_path", f"'{self.usd_path}' {problem}; give the path of a file"


def found_terrain(stage: Usd.Stage) -> TerrainImporterCfg | None:
    """Config of the terrain whose height field a stage holds; None without a height field.

    Raises:
        ValueError: if it holds several.
    """
    prims = ground_prims(stage)
    if not prims:
        return None
    if len(prims) > 1:
        raise ValueError(f"'{prims[0].GetPath()}' and '{prims[1].GetPath()}' are height fields; a scene has one ground")
    path = str(prims[0].GetPath().GetParentPath())
    return TerrainImporterCfg(prim_path=path, terrain_type="stage", **placement(prims[0]))
