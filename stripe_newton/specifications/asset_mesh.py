# SPDX-License-Identifier: Apache-2.0
"""What assets look like and what they are touched by: surfaces made of triangles, and colliders made of primitives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np

__all__ = ["AssetMesh", "Collider", "DynamicMesh", "MeshPart", "instancable"]

Kind = Literal["sphere", "capsule", "cylinder", "box"]
M = TypeVar("M", bound="AssetMesh")
SIZES: dict[str, int] = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3}


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A surface of one colour.

    Attributes:
        name: Name within its asset, an identifier.
        vertices: Corners, float32 ``(V, 3)`` [m], in the frame of the asset: its origin on the ground, z up.
        faces: Triangles, int32 ``(F, 3)``, counterclockwise seen from outside.
        color: Linear RGB in [0, 1].
        roughness: 0 for a mirror, 1 for chalk.
        double_sided: Whether it is seen from behind too, as a leaf is.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    roughness: float = 0.9
    double_sided: bool = False

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float32)
        faces = np.ascontiguousarray(self.faces, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise ValueError(f"mesh part '{self.name}': vertices are {vertices.shape}, must be (V, 3) and finite")
        if (
            faces.ndim != 2
            or faces.shape[1] != 3
            or (faces.size and not 0 <= faces.min() <= faces.max() < len(vertices))
        ):
            raise ValueError(f"mesh part '{self.name}': faces must be (F, 3) and name its {len(vertices)} vertices")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)


@dataclass(frozen=True)
class Collider:
    """A primitive that is touched.

    Attributes:
        kind: ``"sphere"``, ``"capsule"``, ``"cylinder"`` or ``"box"``.
        size: Radius of a sphere; radius and half length, along z, of a capsule (without its caps) or cylinder; half
            extents of a box [m].
        pos: Its centre in the frame of the asset [m].
        rot: Its orientation there, xyzw.
    """

    kind: Kind
    size: tuple[float, ...]
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rot: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.kind not in SIZES:
            raise ValueError(f"collider: kind is '{self.kind}', must be one of {', '.join(SIZES)}")
        if len(self.size) != SIZES[self.kind] or min(self.size) <= 0.0:
            raise ValueError(
                f"collider: size of a {self.kind} is {self.size}, must be {SIZES[self.kind]} lengths above 0"
            )


def instancable(mesh: type[M]) -> type[M]:
    """Class decorator: instances of such meshes share their surfaces, which is what :class:`AssetMesh` does anyway; for
    a subclass of one that does not.
    """
    mesh.instancable = True
    return mesh


class AssetMesh:
    """What an asset is made of. Instances of one mesh object share its surfaces in USD, on disk and on the GPU."""

    instancable: bool = True
    """Whether USD instances it. A subclass that sets False gives each asset prims of its own, to be edited apart."""
    name: str
    """An identifier, unique within a scene."""
    semantic: str = ""
    """Semantic label of what is seen, such as ``"tree"``; the asset's name where empty."""

    def parts(self) -> Sequence[MeshPart]:
        """Surfaces, in the frame of the asset."""
        raise NotImplementedError

    def colliders(self) -> Sequence[Collider]:
        """What is touched; none for what is only seen."""
        return ()


@dataclass(eq=False)
class DynamicMesh(AssetMesh):
    """A mesh that was computed rather than read from a file."""

    name: str
    surfaces: Sequence[MeshPart] = ()
    touched: Sequence[Collider] = ()
    semantic: str = ""
    radius: float = field(default=0.0)
    """Space that it takes on the ground, for placing [m]."""

    def parts(self) -> Sequence[MeshPart]:
        return self.surfaces

    def colliders(self) -> Sequence[Collider]:
        return self.touched
