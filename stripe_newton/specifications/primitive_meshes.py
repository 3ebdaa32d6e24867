# SPDX-License-Identifier: Apache-2.0
"""Primitive meshes: boxes, spheres, capsules, cylinders and cones, which are their own colliders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from .asset_mesh import AssetMesh, Collider, Kind, MeshPart
from .collider_fitting import fit_collider

__all__ = ["BoxMesh", "CapsuleMesh", "ConeMesh", "CylinderMesh", "DebugMesh", "PrimitiveMesh", "SphereMesh"]


class PrimitiveMesh(AssetMesh):
    """Base of the simple shapes. A shape stands on the ground: its lowest point is at z = 0.

    Args:
        name: An identifier.
        size: Lengths, as the subclass says [m].
        color: Linear RGB.
        touched: Whether it has a collider.
        semantic: Semantic label; the name where empty.
    """

    kind: Kind | None = None
    """Kind of its collider. None: a primitive is fitted."""

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
        # trimesh centres its shapes; lifted, they stand on the ground, and so do their colliders.
        self._lift = -float(mesh.vertices[:, 2].min())
        vertices = np.asarray(mesh.vertices) + [0.0, 0.0, self._lift]
        self._part = MeshPart("surface", vertices, np.asarray(mesh.faces), color)

    def _mesh(self) -> trimesh.Trimesh:
        raise NotImplementedError

    def parts(self) -> Sequence[MeshPart]:
        return [self._part]

    def colliders(self) -> Sequence[Collider]:
        if not self.touched:
            return []
        if self.kind is None:
            return [fit_collider(self._part.vertices)]
        return [Collider(self.kind, self.size, (0.0, 0.0, self._lift))]


class BoxMesh(PrimitiveMesh):
    """A box; ``size`` are its half extents [m]."""

    kind = "box"

    def _mesh(self) -> trimesh.Trimesh:
        return trimesh.creation.box(2.0 * np.array(self.size))


class SphereMesh(PrimitiveMesh):
    """A sphere; ``size`` is its radius [m]."""

    kind = "sphere"

    def _mesh(self) -> trimesh.Trimesh:
        return trimesh.creation.icosphere(2, self.size[0])


class CapsuleMesh(PrimitiveMesh):
    """An upright capsule; ``size`` are its radius and half the length of its straight part [m]."""

    kind = "capsule"

    def _mesh(self) -> trimesh.Trimesh:
        mesh = trimesh.creation.capsule(2.0 * self.size[1], self.size[0], count=(12, 12))
        mesh.vertices -= mesh.bounds.mean(axis=0)  # trimesh's capsule is not centred
        return mesh


class CylinderMesh(PrimitiveMesh):
    """An upright cylinder; ``size`` are its radius and half its height [m]."""

    kind = "cylinder"

    def _mesh(self) -> trimesh.Trimesh:
        return trimesh.creation.cylinder(self.size[0], 2.0 * self.size[1], sections=20)


class ConeMesh(PrimitiveMesh):
    """An upright cone; ``size`` are its radius and half its height [m]. A primitive is fitted around it as collider."""

    def _mesh(self) -> trimesh.Trimesh:
        return trimesh.creation.cone(self.size[0], 2.0 * self.size[1], sections=20)


class DebugMesh(SphereMesh):
    """A marker without collider that is only generated with ``debug_models=True``."""

    def __init__(self, name: str, radius: float = 0.1, color: tuple[float, float, float] = (1.0, 0.0, 1.0)):
        super().__init__(name, (radius,), color, touched=False)
