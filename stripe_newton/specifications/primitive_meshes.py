# SPDX-License-Identifier: Apache-2.0
"""Meshes of simple shapes, which are their own colliders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .asset_mesh import AssetMesh, Collider, Kind, MeshPart

__all__ = ["BoxMesh", "CapsuleMesh", "ConeMesh", "CylinderMesh", "DebugMesh", "PrimitiveMesh", "SphereMesh"]


class PrimitiveMesh(AssetMesh):
    """A shape that stands on the ground.

    Args:
        name: An identifier.
        color: Linear RGB.
        touched: Whether it has a collider.
        semantic: Semantic label; the name where empty.
    """

    kind: Kind | None = None
    """Kind of its collider; None for a fitted one."""

    def __init__(
        self,
        name: str,
        size: tuple[float, ...],
        color: tuple[float, float, float] = (0.5, 0.5, 0.5),
        touched: bool = True,
        semantic: str = "",
    ):
        if min(size) <= 0.0 or not np.isfinite(size).all():
            raise ValueError(f"{type(self).__name__} '{name}': size is {size}, lengths must be positive [m]")
        self.name, self.size, self.color = name, tuple(float(s) for s in size), color
        self.touched, self.semantic = touched, semantic
        mesh = self._mesh()
        self._lift = -float(mesh.vertices[:, 2].min())
        vertices = np.asarray(mesh.vertices) + [0.0, 0.0, self._lift]
        self._part = MeshPart("surface", vertices, np.asarray(mesh.faces), color)

    def _mesh(self) -> Any:
        raise NotImplementedError

    def parts(self) -> Sequence[MeshPart]:
        return [self._part]

    def colliders(self) -> Sequence[Collider]:
        if not self.touched:
            return []
        if self.kind is None:
            from .collider_fitting import fit_collider

            return [fit_collider(self._part.vertices)]
        return [Collider(self.kind, self.size, (0.0, 0.0, self._lift))]


class BoxMesh(PrimitiveMesh):
    """A box; ``size`` are its half extents [m]."""

    kind = "box"

    def _mesh(self) -> Any:
        import trimesh

        return trimesh.creation.box(2.0 * np.array(self.size))


class SphereMesh(PrimitiveMesh):
    """A sphere; ``size`` is its radius [m]."""

    kind = "sphere"

    def _mesh(self) -> Any:
        import trimesh

        return trimesh.creation.icosphere(2, self.size[0])


class CapsuleMesh(PrimitiveMesh):
    """An upright capsule; ``size`` are its radius and half the length of its straight part [m]."""

    kind = "capsule"

    def _mesh(self) -> Any:
        import trimesh

        mesh = trimesh.creation.capsule(2.0 * self.size[1], self.size[0], count=(12, 12))
        mesh.vertices -= mesh.bounds.mean(axis=0)
        return mesh


class CylinderMesh(PrimitiveMesh):
    """An upright cylinder; ``size`` are its radius and half its height [m]."""

    kind = "cylinder"

    def _mesh(self) -> Any:
        import trimesh

        return trimesh.creation.cylinder(self.size[0], 2.0 * self.size[1], sections=20)


class ConeMesh(PrimitiveMesh):
    """An upright cone; ``size`` are its radius and half its height [m]. Its collider is fitted around it."""

    def _mesh(self) -> Any:
        import trimesh

        return trimesh.creation.cone(self.size[0], 2.0 * self.size[1], sections=20)


class DebugMesh(SphereMesh):
    """A marker, which is authored only with ``debug_models=True`` and never touched."""

    def __init__(self, name: str, radius: float = 0.1, color: tuple[float, float, float] = (1.0, 0.0, 1.0)):
        super().__init__(name, (radius,), color, touched=False)
