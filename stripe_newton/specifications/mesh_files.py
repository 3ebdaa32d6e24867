# SPDX-License-Identifier: Apache-2.0
"""Mesh files: asset meshes read from USD files, or from any format that trimesh reads."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import newton.usd
import numpy as np
import trimesh
from pxr import Usd, UsdGeom

from stripe_newton.input_files import why_no_file
from stripe_newton.usd import open_stage

from .asset_mesh import AssetMesh, Collider, MeshPart
from .collider_fitting import fit_collider

__all__ = ["USDMesh", "UniversalMesh"]

_USD = (".usd", ".usda", ".usdc", ".usdz")

Surface = tuple[str, np.ndarray, np.ndarray, tuple[float, float, float]]
"""Name, vertices [m], triangles and linear RGB."""


class _FileMesh(AssetMesh):
    """Base of the meshes from files. The file is read at the first use.

    Args:
        path: The file.
        name: An identifier; by default made from the file's name.
        scale: Factor on all lengths.
        collider: Kind of primitive to fit around it, ``"auto"`` for the smallest, None for no collider.
        semantic: Semantic label; the name where empty.

    Raises:
        FileNotFoundError: if there is no such file.
    """

    def __init__(
        self,
        path: str | Path,
        name: str | None = None,
        scale: float = 1.0,
        collider: str | None = "auto",
        semantic: str = "",
    ):
        self.path = Path(path).expanduser()
        if problem := why_no_file(self.path):
            raise FileNotFoundError(f"{type(self).__name__}: '{path}' {problem}; give the path of a file")
        if not (np.isfinite(scale) and scale > 0.0):
            raise ValueError(f"{type(self).__name__} '{path}': scale is {scale}, must be positive")
        # Names of prims are identifiers, those of files seldom are.
        self.name = name or re.sub(r"\W", "_", self.path.stem)
        self.scale, self.collider, self.semantic = float(scale), collider, semantic

    def parts(self) -> Sequence[MeshPart]:
        return self._parts

    def colliders(self) -> Sequence[Collider]:
        return self._colliders

    @cached_property
    def _colliders(self) -> list[Collider]:
        if self.collider is None:
            return []
        points = np.concatenate([part.vertices for part in self._parts])
        return [fit_collider(points, self.collider)]

    @cached_property
    def _parts(self) -> list[MeshPart]:
        parts = [
            MeshPart(re.sub(r"\W", "_", name) or "part", vertices * self.scale, faces, color)
            for name, vertices, faces, color in self._read()
        ]
        if not parts:
            raise ValueError(f"{type(self).__name__} '{self.path}': has no triangles")
        return parts

    def _read(self) -> list[Surface]:
        raise NotImplementedError


class UniversalMesh(_FileMesh):
    """A mesh file of any format that trimesh reads, such as OBJ, STL, PLY, GLB and OFF; in metres, z up."""

    def _read(self) -> list[Surface]:
        if self.path.suffix.lower() in _USD:
            raise ValueError(f"UniversalMesh '{self.path}': is a USD file, use USDMesh")
        try:
            scene = trimesh.load_scene(self.path, process=False)
        except Exception as error:  # trimesh's readers raise all kinds
            raise ValueError(f"UniversalMesh '{self.path}': {error}") from error
        found = []
        for node in scene.graph.nodes_geometry:
            matrix, geometry = scene.graph[node]
            mesh = scene.geometry[geometry]
            if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):  # point clouds and paths
                continue
            # A texture has no main colour.
            color = np.asarray(getattr(mesh.visual, "main_color", (128, 128, 128, 255)), dtype=float)[:3] / 255.0
            vertices = trimesh.transform_points(mesh.vertices, matrix)
            red, green, blue = (  # sRGB to linear, IEC 61966-2-1
                float(c) for c in np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
            )
            found.append((str(geometry), vertices, mesh.faces, (red, green, blue)))
        return found


class USDMesh(_FileMesh):
    """The visible meshes of a USD file, converted to metres and z up."""

    def _read(self) -> list[Surface]:
        stage = open_stage(self.path)
        unit, y_up = UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
        cache, found = UsdGeom.XformCache(), []
        for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
            image = UsdGeom.Imageable(prim)
            if not prim.IsA(UsdGeom.Mesh) or image.ComputeVisibility() == UsdGeom.Tokens.invisible:
                continue
            if image.ComputePurpose() == UsdGeom.Tokens.guide:  # colliders, by convention
                continue
            mesh = newton.usd.get_mesh(prim)
            matrix = np.array(cache.GetLocalToWorldTransform(prim))
            points = (np.asarray(mesh.vertices) @ matrix[:3, :3] + matrix[3, :3]) * unit
            points = points @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float) if y_up else points
            faces = np.asarray(mesh.indices).reshape(-1, 3)
            # A mirror turns triangles inside out.
            faces = faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0.0 else faces
            shown = UsdGeom.Mesh(prim).GetDisplayColorAttr().Get()
            red, green, blue = map(float, shown[0]) if shown else (0.5, 0.5, 0.5)
            found.append((prim.GetName(), points, faces, (red, green, blue)))
        return found
