# SPDX-License-Identifier: Apache-2.0
"""Asset instance: one asset of a scene with its mesh and pose."""

from __future__ import annotations

from dataclasses import dataclass

from .asset_mesh import AssetMesh

__all__ = ["AssetInstance"]


@dataclass(frozen=True, eq=False)
class AssetInstance:
    """One asset with its pose.

    Attributes:
        name: Name of the instance, unique within its spec.
        mesh: Surfaces and colliders.
        position: World position of the mesh's origin [m].
        rotation: Orientation, xyzw.
        scale: Factor on its size.
        tags: Semantic labels in addition to that of the mesh.
    """

    name: str
    mesh: AssetMesh
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: float = 1.0
    tags: tuple[str, ...] = ()

    @property
    def labels(self) -> list[str]:
        """Semantic labels: that of the mesh, then the tags."""
        return [self.mesh.semantic or self.mesh.name, *self.tags]
