# SPDX-License-Identifier: Apache-2.0
"""Asset specifications: which assets a scene has, and where they are placed."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

import numpy as np

from .asset_instance import AssetInstance
from .asset_mesh import AssetMesh
from .terrain_instance import TerrainInstance

__all__ = ["AssetSpec", "IdenticalAssetSpec"]


class AssetSpec(ABC):
    """Base of the specifications of assets of one kind; a subclass generates the instances.

    Args:
        name: An identifier, unique within the scene.
    """

    def __init__(self, name: str):
        if not name.isidentifier():
            raise ValueError(f"asset '{name}': the name must be an identifier: letters, digits and '_'")
        self.name = name

    @abstractmethod
    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterable[AssetInstance]:
        """Generate the instances on a terrain.

        Args:
            terrain: The ground; ``terrain.placed`` has the assets of the specifications before this one.
            rng: The only source of random numbers; equal generators give equal instances.
        """

    def create_instance(
        self,
        name: str,
        mesh: AssetMesh,
        position: Sequence[float],
        rotation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        scale: float = 1.0,
        tags: Sequence[str] = (),
    ) -> AssetInstance:
        """Create an instance and check its values.

        Raises:
            ValueError: if the name is no identifier, or numbers are not finite.
        """
        where = f"asset '{self.name}', instance '{name}'"
        if not name.isidentifier():
            raise ValueError(f"{where}: the name must be an identifier: letters, digits and '_'")
        x, y, z = (float(p) for p in position)
        qx, qy, qz, qw = (float(q) for q in rotation)
        # Callers may give quaternions of any length: it is normalised below.
        length = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        if not math.isfinite(x + y + z) or not math.isfinite(length) or length < 1.0e-6:
            raise ValueError(f"{where}: position {tuple(position)} and rotation {tuple(rotation)} must be finite")
        if not (math.isfinite(scale) and scale > 0.0):
            raise ValueError(f"{where}: scale is {scale}, must be positive")
        quat = (qx / length, qy / length, qz / length, qw / length)
        return AssetInstance(name, mesh, (x, y, z), quat, float(scale), tuple(tags))


class IdenticalAssetSpec(AssetSpec):
    """Copies of one mesh; a subclass finds the positions.

    Args:
        name: An identifier, unique within the scene.
        mesh: Mesh of all instances.
        rotation: Orientation of all instances, xyzw. None: a random rotation about z for each.
    """

    def __init__(self, name: str, mesh: AssetMesh, rotation: Sequence[float] | None = None):
        super().__init__(name)
        self.mesh, self.rotation = mesh, rotation

    @abstractmethod
    def find_positions(self, terrain: TerrainInstance, rng: np.random.Generator) -> np.ndarray:
        """World positions [m], shape ``(N, 3)``, or ``(N, 2)`` for positions on the ground."""

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterable[AssetInstance]:
        positions = np.asarray(self.find_positions(terrain, rng), dtype=float)
        if positions.ndim != 2 or positions.shape[1] not in (2, 3):
            raise ValueError(f"asset '{self.name}': positions are {positions.shape}, must be (N, 2) or (N, 3)")
        if positions.shape[1] == 2:
            heights = terrain.ground.height_at(positions[:, 0], positions[:, 1])
            positions = np.column_stack([positions, heights])
        # Drawn also where it is not used, so that a fixed rotation changes no later random number.
        yaw = rng.uniform(-math.pi, math.pi, len(positions))
        for index, position in enumerate(positions):
            turn = self.rotation or (0.0, 0.0, math.sin(0.5 * yaw[index]), math.cos(0.5 * yaw[index]))
            yield self.create_instance(f"{self.name}_{index}", self.mesh, position, turn)
