# SPDX-License-Identifier: Apache-2.0
"""Mesh copies: a mesh of Newton with other vertices and faces, and all else as it was."""

from __future__ import annotations

import newton
import numpy as np

__all__ = ["with_geometry"]


def with_geometry(
    mesh: newton.Mesh, vertices: np.ndarray, indices: np.ndarray, normals: np.ndarray | None, uvs: np.ndarray | None
) -> newton.Mesh:
    """A mesh with the look of another one. ``Mesh.copy`` keeps normals and texture coordinates, which must fit.

    Args:
        mesh: The other one, which stays as it is: shapes may share it.
        vertices: Shape ``(vertices, 3)``.
        indices: Three for each triangle, shape ``(3 * triangles,)``.
        normals: Of the vertices, shape ``(vertices, 3)``; None for those of the faces.
        uvs: Texture coordinates, shape ``(vertices, 2)``; None without a texture.
    """
    made = newton.Mesh(
        vertices,
        indices,
        normals=normals,
        uvs=uvs,
        compute_inertia=False,
        is_solid=mesh.is_solid,
        maxhullvert=mesh.maxhullvert,
        color=mesh.color,
        opacity=mesh.opacity,
        texture=mesh.texture,
        roughness=mesh.roughness,
        metallic=mesh.metallic,
    )
    made.texture_transform = mesh.texture_transform  # no argument of the constructor
    return made
