# SPDX-License-Identifier: Apache-2.0
"""Scenery ground: an imported world as the ground of a scene, with the places where robots start."""

from __future__ import annotations

from collections.abc import Mapping

import newton
import numpy as np
import torch
import warp as wp
from pxr import Usd

from stripe_kernels.terrain import TerrainData
from stripe_newton.assets import TerrainBase

from .collider_mesh import collider_mesh, triangles_of
from .start_spots import Floors

__all__ = ["SceneryGround", "Triangles"]

_FAR = 1.0e9
"""Half the extent of a ground without an edge [m]."""
_BELOW = 1.0
"""Depth below the lowest point of the world at which a robot has left it [m]."""


class Triangles:
    """The triangles of static colliders, for rays and for the search of places to start.

    Attributes:
        mesh: The triangles on the device.
        bounds: Lower and upper corner of where robots start [m], shape ``(2, 3)``.
        endless: Whether a plane is among them, so that there is no edge to fall from.
    """

    def __init__(self, builder: newton.ModelBuilder, shapes: list[int], device: str):
        """Make the mesh.

        Args:
            builder: Builder of what all environments share.
            shapes: Its static colliders.
            device: Device of the mesh.
        """
        self._triangles = triangles_of(builder, shapes)
        self.mesh = collider_mesh(*self._triangles, device)
        # A plane says nothing of where the world ends: robots may walk around what stands on it.
        planes = [i for i in shapes if builder.shape_type[i] == newton.GeoType.PLANE]
        self.endless = bool(planes)
        heights = [float(builder.shape_transform[i][2]) for i in planes]
        ends = triangles_of(builder, [i for i in shapes if i not in planes])[0]
        if not len(ends):
            ends = np.array([[-10.0, -10.0, heights[0]], [10.0, 10.0, heights[0]]])
        margin = 2.0 if planes else 0.0
        low, high = ends.min(axis=0), ends.max(axis=0)
        self.bounds = np.array(
            [
                [low[0] - margin, low[1] - margin, min([low[2], *heights])],
                [high[0] + margin, high[1] + margin, max([high[2], *heights])],
            ]
        )

    def with_bodies(self, points: np.ndarray, faces: np.ndarray) -> wp.Mesh:
        """A mesh that also has the triangles of bodies that stand in the world when an episode begins."""
        if not len(faces):
            return self.mesh
        own, own_faces = self._triangles
        every = np.concatenate([own_faces, faces + len(own)])
        return collider_mesh(np.concatenate([own, points]), every, str(self.mesh.device))


class SceneryGround(TerrainBase):
    """An imported world as ``scene.terrain``: places to start, heights below a point, and its bounds.

    It has one level and one type, and its places are the flat patches ``init_pos`` and ``target`` of Isaac Lab's terms.

    Attributes:
        spots: Places where robots start [m], shape ``(spots, 3)``.
        env_origins: Origins of the environments [m], shape ``(num_envs, 3)``: the tensor of the scene.
        terrain_origins: None, as there are no tiles.
        terrain_levels: Level of each environment, all 0, int32, shape ``(num_envs,)``.
        terrain_types: Type of each environment, all 0, int32, shape ``(num_envs,)``.
        kept: The task's own ground, if it stays; None if the world has taken its place.
    """

    struct: TerrainData
    terrain_origins = None

    def __init__(
        self,
        path: str,
        triangles: Triangles,
        floors: Floors,
        spots: np.ndarray,
        env_origins: torch.Tensor,
        kept: TerrainBase | None,
        labels: Mapping[str, str],
    ):
        """Move the environments to the places.

        Args:
            path: Prim path.
            triangles: The world.
            floors: Its floors.
            spots: Places where robots start [m], shape ``(spots, 3)``.
            env_origins: Origins of the environments, which this writes [m], shape ``(num_envs, 3)``.
            kept: The task's own ground, if it stays.
            labels: Semantic labels of its prims, by path.
        """
        self.path, self.kept, self.floors, self._triangles = path, kept, floors, triangles
        self.labels = labels
        self.env_origins, self.num_envs = env_origins, len(env_origins)
        device = env_origins.device
        self.spots = torch.tensor(spots, device=device)
        self.terrain_levels, self.terrain_types = torch.zeros((2, self.num_envs), dtype=torch.int32, device=device)
        every = torch.arange(self.num_envs, device=device) % len(spots)
        env_origins.copy_(self.spots[every])  # in place: assets and sensors hold views of it
        self.flat_patches = {"init_pos": self.spots[None, None], "target": self.spots[None, None]}
        self._fill_struct()

    def _fill_struct(self) -> None:
        low, high = self._triangles.bounds
        data, device = TerrainData(), self._triangles.mesh.device
        data.mesh, data.top, data.bottom = self._triangles.mesh.id, float(high[2]) + 0.1, float(low[2]) - _BELOW
        # Lookups by x and y go to the mesh: of the field, only the edge counts.
        edge = np.full(2, _FAR) if self._triangles.endless else np.zeros(2)
        data.heights = wp.full((2, 2), value=float(low[2]), dtype=float, device=device)
        data.lower, data.cell = wp.vec2(*(low[:2] - edge)), wp.vec2(*(high[:2] - low[:2] + 2.0 * edge))
        data.tile, data.origins = wp.vec2(0.0, 0.0), wp.zeros((0, 0), dtype=wp.vec3, device=device)
        patches = wp.from_torch(self.spots[None, None].contiguous(), dtype=wp.vec3)
        data.init_pos, data.target = patches, patches
        data.level, data.kind = wp.from_torch(self.terrain_levels), wp.from_torch(self.terrain_types)
        data.env_origin = wp.from_torch(self.env_origins, dtype=wp.vec3)
        self.struct = data

    @property
    def arrays(self) -> dict[str, wp.array]:
        return {"env_origin": self.struct.env_origin}

    def add_to(self, static: newton.ModelBuilder) -> None:
        """Nothing: its shapes, and those of a ground that stays, are in the builder already."""

    def author(self, stage: Usd.Stage) -> None:
        if self.kept is not None:
            self.kept.author(stage)

    def update_env_origins(self, env_ids: torch.Tensor, move_up: torch.Tensor, move_down: torch.Tensor) -> None:
        """Nothing: there are no levels."""

    def describe(self) -> str:
        """Places and floors in one line."""
        f = self.floors
        return (
            f"{len(self.spots)} places to start on {f.area:.1f} m^2 of floors, with {f.radius:.2f} m around and "
            f"{f.height:.2f} m above free"
        )
