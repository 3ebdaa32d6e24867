# SPDX-License-Identifier: Apache-2.0
"""Asset meshes: visible surfaces of triangles, and colliders that are primitives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

__all__ = ["AssetMesh", "Collider", "DynamicMesh", "MeshPart", "instancable"]

# Only what MuJoCo and Newton have as primitives: a mesh as collider costs many times as much.
Kind = Literal["sphere", "capsule", "cylinder", "box"]
M = TypeVar("M", bound="AssetMesh")
SIZES: dict[str, int] = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3}
"""Number of lengths in the size of each kind of collider."""


FOLIAGE = ("", "leaves", "spruce", "pine")
"""Possible values of ``MeshPart.foliage``."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A visible surface of one colour.

    Attributes:
        name: Name within its asset, an identifier.
        vertices: Vertices in the frame of the asset, float32 ``(V, 3)`` [m]: origin on the ground, z up.
        faces: Triangles, int32 ``(F, 3)``, counterclockwise when seen from outside.
        color: Linear RGB in [0, 1].
        roughness: 0 for a mirror, 1 for chalk.
        double_sided: Whether it is also visible from behind, like a leaf.
        foliage: What its triangles stand for in pictures: bunches of ``"leaves"``, twigs of a ``"spruce"`` or a
            ``"pine"``, or ``""`` for themselves.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    roughness: float = 0.9
    double_sided: bool = False
    foliage: str = ""

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
        if self.foliage not in FOLIAGE:
            kinds = ", ".join(map(repr, FOLIAGE))
            raise ValueError(f"mesh part '{self.name}': foliage is {self.foliage!r}, must be one of {kinds}")
        # A frozen dataclass sets its own fields this way.
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)


@dataclass(frozen=True)
class Collider:
    """A primitive that robots collide with.

    Attributes:
        kind: ``"sphere"``, ``"capsule"``, ``"cylinder"`` or ``"box"``.
        size: Radius of a sphere; radius and half length along z of a cylinder, or of a capsule without its caps; half
            extents of a box [m].
        pos: Centre in the frame of the asset [m].
        rot: Orientation in the frame of the asset, xyzw.
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
    """Class decorator: instances of such meshes share their surfaces.

    This is the default of :class:`AssetMesh`; the decorator is for a subclass of a class that sets it to False.
    """
    mesh.instancable = True
    return mesh


class AssetMesh:
    """Surfaces and colliders of an asset. Instances of one mesh object share them in USD, on disk and on the GPU."""

    instancable: bool = True
    """Whether USD instances it. With False each asset gets prims of its own, which can be edited one by one."""
    name: str
    """An identifier, unique within a scene."""
    semantic: str = ""
    """Semantic label, such as ``"tree"``. Empty: the name."""

    def parts(self) -> Sequence[MeshPart]:
        """Visible surfaces in the frame of the asset."""
        raise NotImplementedError

    def colliders(self) -> Sequence[Collider]:
        """Colliders in the frame of the asset; none by default."""
        return ()


@dataclass(eq=False)
class DynamicMesh(AssetMesh):
    """A mesh that is computed rather than read from a file."""

    name: str
    surfaces: Sequence[MeshPart] = ()
    touched: Sequence[Collider] = ()
    semantic: str = ""
    radius: float = 0.0
    """Radius of the space that it takes on the ground, for placing [m]."""

    def parts(self) -> Sequence[MeshPart]:
        return self.surfaces

    def colliders(self) -> Sequence[Collider]:
        return self.touched
