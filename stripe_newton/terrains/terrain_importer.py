# SPDX-License-Identifier: Apache-2.0
"""What the environments stand on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import newton
import numpy as np
import torch
import warp as wp

from stripe_kernels.terrain import TerrainData
from stripe_newton.assets import TerrainBase
from stripe_newton.sim import GroundPlaneCfg
from stripe_newton.sim.scene_context import authored_path, current_scene

from .ground import Ground
from .origins import grid_origins, tile_of
from .terrain_generator import TerrainGenerator
from .terrain_generator_cfg import TerrainGeneratorCfg

if TYPE_CHECKING:
    from pxr import Usd

    from .terrain_importer_cfg import TerrainImporterCfg

__all__ = ["TerrainImporter"]

_FAR = 1.0e9
"""Half the extent of a plane, for look-ups of its height [m]."""


class TerrainImporter(TerrainBase):
    """The ground of the scene under construction: an endless plane, or one height field for all environments.

    Its constructor spawns it and decides where the environments start. On tiles, environment ``i`` is of type
    ``i % num_cols`` and starts at a random level; both depend on its index alone.

    Attributes:
        cfg: The config.
        ground: The height field on the host; None for a plane.
        generator: What made it, for generated tiles.
        terrain_origins: Origins of the tiles [m], shape ``(levels, types, 3)``; None where there are none.
        terrain_levels: Level of each environment, int32, shape ``(num_envs,)``.
        terrain_types: Type of each environment, int32, shape ``(num_envs,)``.
        env_origins: Origins of the environments [m], shape ``(num_envs, 3)``: the tensor of the scene.
        flat_patches: Level patches by name [m], shape ``(levels, types, num_patches, 3)``.
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
        self.env_origins: torch.Tensor = scene.env_origins
        self._place()
        self._fill_struct()
        scene.terrain = self

    def _make_ground(self) -> Ground | None:
        from pxr import UsdGeom

        from .exchange import ground_prims, read_ground

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
            return None
        UsdGeom.Xform.Define(stage, self.path)
        if cfg.terrain_type == "usd":
            from .files import ground_from_file

            return ground_from_file(str(cfg.usd_path), cfg.horizontal_scale, self._scene.device)
        self.generator = TerrainGenerator(cfg.terrain_generator or TerrainGeneratorCfg())
        return self.generator.ground

    def _place(self) -> None:
        """Levels, types and origins of the environments."""
        ground = self.ground
        origins = ground.origins if ground is not None else None
        levels, types = np.zeros((2, self.num_envs), dtype=np.int32)
        self.terrain_origins = None
        if ground is not None and origins is not None:
            self.terrain_origins = torch.tensor(origins, dtype=torch.float32, device=self.device)
            most = self.cfg.max_init_terrain_level
            levels, types = tile_of(self.num_envs, origins.shape[:2], most, ground.seed)
        own = self._origins_of(ground, levels, types)
        self.terrain_levels = torch.tensor(levels, device=self.device)
        self.terrain_types = torch.tensor(types, device=self.device)
        self.env_origins.copy_(torch.tensor(own, dtype=torch.float32))

    def _origins_of(self, ground: Ground | None, levels: np.ndarray, types: np.ndarray) -> np.ndarray:
        """Where environments of some levels and types start on a ground [m], shape ``(num_envs, 3)``."""
        if ground is not None and ground.origins is not None and self.cfg.use_terrain_origins:
            return np.asarray(ground.origins[levels, types])
        spacing = self._scene.cfg.env_spacing if self.cfg.env_spacing is None else self.cfg.env_spacing
        return grid_origins(self.num_envs, spacing, ground)

    def _fill_struct(self) -> None:
        ground, device = self.ground, self.device
        data = TerrainData()
        heights, lower, cell, tile = (
            np.zeros((2, 2), dtype=np.float32),
            (-_FAR, -_FAR),
            (2 * _FAR, 2 * _FAR),
            (0.0, 0.0),
        )
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
            empty = points is None or tiles is None
            array = wp.zeros((1, 1, 0), dtype=wp.vec3, device=device) if empty else wp.from_torch(points, dtype=wp.vec3)
            setattr(data, name, array)
        data.level, data.kind = wp.from_torch(self.terrain_levels), wp.from_torch(self.terrain_types)
        data.env_origin = wp.from_torch(self.env_origins, dtype=wp.vec3)
        self.struct = data

    @property
    def arrays(self) -> dict[str, wp.array]:
        """What lasts from step to step, by name."""
        return {"level": self.struct.level, "env_origin": self.struct.env_origin}

    # -- the scene calls these

    def add_to(self, static: newton.ModelBuilder) -> None:
        """Add the height field to what all environments share.

        Raises:
            ValueError: if a collider lies at or below its path already, such as a ground plane.
        """
        if self.ground is None:
            return
        solid = int(newton.ShapeFlags.COLLIDE_SHAPES)
        shapes = zip(static.shape_label, static.shape_flags, strict=True)
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
        from .exchange import author_ground

        if self.ground is not None:
            author_ground(stage, self)

    # -- another ground in the place of the one that there is

    def check(self, ground: Ground) -> None:
        """Whether a ground can take the place of the one that is there.

        Raises:
            ValueError: if its heights lie on another grid, or it has other numbers of tiles or patches.
        """
        mine, where = self.ground, f"'{self.cfg.prim_path}'"
        if mine is None:
            raise ValueError(f"{where}: is a plane, which no height field can replace")
        for name, what in (("heights", "heights"), ("origins", "origins of tiles")):
            here, new = (None if v is None else v.shape for v in (getattr(mine, name), getattr(ground, name)))
            if here != new:
                raise ValueError(f"{where}: the new ground has {what} of shape {new}, must be {here} as now")
        for name in ("lower", "cell", "tile"):
            here, new = getattr(mine, name), getattr(ground, name)
            if not np.allclose(here, new, rtol=1.0e-5, atol=1.0e-6):
                raise ValueError(f"{where}: {name} of the new ground is {tuple(new)} m, must be {tuple(here)} m as now")
        here, new = ({name: points.shape for name, points in g.patches.items()} for g in (mine, ground))
        if here != new:
            raise ValueError(f"{where}: the new ground has the patches {new or 'none'}, must have {here or 'none'}")

    def replace(self, ground: Ground) -> None:
        """Put another ground in the place of the one that is there; graphs stay as they are, and levels too.

        The model and sensors have their own copies of it: :meth:`InteractiveScene.regenerate` writes all of them.

        Raises:
            ValueError: see :meth:`check`.
        """
        self.check(ground)
        levels, types = self.terrain_levels.cpu().numpy(), self.terrain_types.cpu().numpy()
        own = self._origins_of(ground, levels, types)
        self.ground = ground
        self.struct.heights.assign(ground.heights)
        if self.terrain_origins is not None:
            self.terrain_origins.copy_(torch.tensor(ground.origins, dtype=torch.float32))
        for name, points in self.flat_patches.items():
            points.copy_(torch.tensor(ground.patches[name], dtype=torch.float32))
        self.env_origins.copy_(torch.tensor(own, dtype=torch.float32))

    # -- levels

    def update_env_origins(self, env_ids: torch.Tensor, move_up: torch.Tensor, move_down: torch.Tensor) -> None:
        """Move environments to other levels of their type; past the last one a random level follows.

        Args:
            env_ids: Environments, shape ``(n,)``.
            move_up: Whether to a harder level, bool, shape ``(n,)``.
            move_down: Whether to an easier one, bool, shape ``(n,)``.
        """
        if self.terrain_origins is None or not self.cfg.use_terrain_origins:
            return
        ids = torch.as_tensor(env_ids, device=self.device).long()
        last = len(self.terrain_origins) - 1
        levels = self.terrain_levels[ids] + move_up.to(torch.int32) - move_down.to(torch.int32)
        drawn = torch.randint_like(levels, last + 1)
        self.terrain_levels[ids] = torch.where(levels > last, drawn, levels.clip(min=0))
        self.env_origins[ids] = self.terrain_origins[self.terrain_levels[ids].long(), self.terrain_types[ids].long()]

    def height_at(self, positions: torch.Tensor) -> torch.Tensor:
        """Height of the ground at points of the world [m], shape ``(...)`` for points ``(..., 2)`` or ``(..., 3)``."""
        if self.ground is None:
            return torch.zeros_like(positions[..., 0])
        points = positions.detach().cpu().numpy()
        found = self.ground.height_at(points[..., 0], points[..., 1])
        return torch.tensor(found, dtype=torch.float32, device=positions.device)
