# SPDX-License-Identifier: Apache-2.0
"""Scenery files: foliage and ground of scenes outdoors as GLB files, with leaves and soil as textures.

Pictures compute leaves and soil where a ray meets them. A browser gets textures that look alike: a tile of leaves that
repeats over the triangles of a crown, and a picture of the ground from above.
"""

from __future__ import annotations

from functools import lru_cache

import newton
import numpy as np
import warp as wp
from scipy.ndimage import gaussian_filter

from stripe_kernels.picture_ground import draw_ground
from stripe_kernels.picture_leaves import NEEDLE
from stripe_newton.viewers.leaf_meshes import LEAF_STYLES, widened

from .glb_file import glb_of

__all__ = ["foliage_file", "ground_file", "has_colors", "leaf_tile"]

_CELLS = 8
"""Leaves along each side of a tile, before their turns."""
_TILE_PIXELS = 256
"""Side of a tile [px]."""
_GROUND_PIXELS = 2048
"""Largest side of the picture of a ground [px]."""
_GROUND_PIXEL = 0.02
"""Smallest pixel of that picture [m]."""
_SOIL_GAIN, _LEAF_GAIN = 1.8, 1.7
"""Factors of the colours of ground and leaves: browsers have no light that is scattered below and in crowns."""
_RELIEF_SIZE, _RELIEF_PIXELS = 2.0, 512
"""Side of the soil's normal map [m], [px]."""
_CRUMBS = 0.01, 0.028
"""Sizes of crumbs of soil [m]."""
_STEEPNESS = 0.28
"""Steepness of the crumbs."""
_MEAN_SHADE = 172
"""Grey between the leaves of a tile, their mean."""


def foliage_file(mesh: newton.Mesh, color: np.ndarray) -> bytes:
    """Foliage as a GLB file: the triangles of a mesh, wider by a margin, with leaves as a texture with holes.

    Args:
        mesh: Triangles with an attribute ``foliage``, the name of a style in :data:`LEAF_STYLES`.
        color: Mean colour of the leaves, linear RGB.
    """
    style = LEAF_STYLES[mesh.foliage]
    corners = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.indices).reshape(-1, 3)]
    lower, upper = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = (corners.mean(axis=1) - 0.5 * (lower + upper)) / np.maximum(0.5 * (upper - lower), 1.0e-3)
    # Browsers turn the normals of faces that are seen from behind, so that the front has to be outside.
    inside = (normal * outwards).sum(axis=1) < 0.0
    corners[inside] = corners[inside][:, ::-1]
    normal[inside] *= -1.0
    points = widened(corners, style["margin"])
    middle = points.mean(axis=1, keepdims=True)
    along, across = _axes(normal, middle[:, 0], style["rise"])
    # A place of its own in the tile for each triangle, so that no pattern repeats.
    start = np.random.default_rng(0).random((len(points), 1, 2))
    places = np.stack([((points - middle) * axis[:, None]).sum(axis=2) for axis in (along, across)], axis=2)
    uvs = places / _tile_size(style) + start
    return glb_of(
        points.reshape(-1, 3),
        np.arange(3 * len(points)).reshape(-1, 3),
        normals=_rounded_normals(points, normal, lower, upper).reshape(-1, 3),
        uvs=uvs.reshape(-1, 2),
        picture=leaf_tile(mesh.foliage),
        color=np.clip(_LEAF_GAIN * color, 0.0, 1.0),
        has_holes=True,
    )


def _axes(normal: np.ndarray, middle: np.ndarray, rise: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions in the triangles along which leaves grow, and across them, as :func:`leaf_at` has them."""
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1.0e-12)
    flat = middle * (1.0, 1.0, 0.0)
    grow = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1.0e-9) + (0.0, 0.0, rise)
    along = grow - normal * (grow * normal).sum(axis=1, keepdims=True)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1.0e-9)
    return along, np.cross(normal, along)


def _rounded_normals(points: np.ndarray, normal: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Normals of a crown that is lit as a rounded whole, as pictures light it, shape ``(faces, 3, 3)``."""
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1.0e-12)
    outwards = (points - 0.5 * (lower + upper)) / np.maximum(0.5 * (upper - lower), 1.0e-3)
    both = 0.6 * normal[:, None] + outwards * (1.0, 1.0, 0.8)
    return both / np.maximum(np.linalg.norm(both, axis=2, keepdims=True), 1.0e-9)


def _tile_size(style: dict[str, float]) -> np.ndarray:
    """Size of a tile along and across the leaves [m]; the cells are those of :func:`leaf_at`."""
    return _CELLS * np.array([0.6 * style["length"], 0.95 * style["width"]])


@lru_cache
def leaf_tile(name: str) -> np.ndarray:
    """Texture of leaves or twigs, which repeats without a seam.

    Args:
        name: A style in :data:`LEAF_STYLES`, other than the empty one.

    Returns:
        Shades of the leaves as grey, and where they are as alpha, uint8, shape ``(256, 256, 4)``.
    """
    style, rng = LEAF_STYLES[name], np.random.default_rng(1)
    size = _tile_size(style)
    x, y = np.meshgrid(*((np.arange(_TILE_PIXELS) + 0.5) / _TILE_PIXELS * side for side in size))
    tile = np.zeros((_TILE_PIXELS, _TILE_PIXELS, 4), dtype=np.uint8)
    tile[..., :3] = _MEAN_SHADE  # also between leaves: smaller copies of the texture mix both
    for row in range(_CELLS):
        for column in range(_CELLS):
            place = (np.array([column, row]) + 0.15 + 0.7 * rng.random(2)) / _CELLS * size
            angle = style["spread"] * (2.0 * rng.random() - 1.0)
            # Distances to the nearest copy of the leaf, as the tile repeats.
            dx = (x - place[0] + 0.5 * size[0]) % size[0] - 0.5 * size[0]
            dy = (y - place[1] + 0.5 * size[1]) % size[1] - 0.5 * size[1]
            u, v = np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx
            tile[_is_leaf(u, np.abs(v), style)] = (*(3 * [int(255 * (0.35 + 0.65 * rng.random()))]), 255)
    return tile


def _is_leaf(along: np.ndarray, across: np.ndarray, style: dict[str, float]) -> np.ndarray:
    """Where a leaf or twig is, at distances from its middle [m]; the shapes are those of :func:`leaf_at`."""
    t = 2.0 * along / style["length"]
    half = 0.5 * style["width"] * (1.0 - (0.6 if style.get("needles") else 1.0) * t * t)
    inside = (np.abs(t) < 1.0) & (across < half)
    if style.get("needles"):
        comb = (along - 0.7 * across) / NEEDLE
        inside &= (comb - np.floor(comb) < 0.6) | (across < 0.12 * style["width"])
    return inside


def has_colors(field: newton.Heightfield) -> bool:
    """Whether a height field has colours, as the grounds of scenes outdoors have."""
    return getattr(field, "colors", None) is not None


def ground_file(field: newton.Heightfield, pose: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """The ground as a GLB file, with its colours, moss and litter as a texture.

    Args:
        field: Height field with an attribute ``colors``, linear RGB, shape ``(rows, columns, 3)``.
        pose: Its pose in the world, of which the position counts, shape ``(7,)``.
        vertices: Its surface in its own frame [m], shape ``(n, 3)``.
        faces: Triangles of the surface, shape ``(m, 3)``.
    """
    half = np.array([field.hx, field.hy])
    uvs = 0.5 + (vertices[:, :2] / half * (0.5, -0.5))
    relief = _soil_relief(), 2.0 * float(half.max()) / _RELIEF_SIZE
    return glb_of(vertices, faces, uvs=uvs, picture=_ground_picture(field, pose), relief=relief, is_jpeg=True)


@lru_cache
def _soil_relief() -> np.ndarray:
    """Normal map of soil, which repeats without a seam: crumbs finer than the pixels of the ground's picture."""
    noise = np.random.default_rng(2).standard_normal((_RELIEF_PIXELS, _RELIEF_PIXELS))
    sigmas = np.array(_CRUMBS) / _RELIEF_SIZE * _RELIEF_PIXELS
    # With 'wrap' the noise is periodic, and so is the map.
    layers = [gaussian_filter(noise, sigma, mode="wrap") for sigma in sigmas]
    heights = sum(sigma * layer / layer.std() for sigma, layer in zip(sigmas, layers, strict=True))
    slopes = [0.5 * (np.roll(heights, -1, axis) - np.roll(heights, 1, axis)) for axis in (1, 0)]
    normals = np.stack([-_STEEPNESS * slopes[0], _STEEPNESS * slopes[1], np.ones_like(noise)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return np.round(127.5 + 127.5 * normals).astype(np.uint8)


def _ground_picture(field: newton.Heightfield, pose: np.ndarray) -> np.ndarray:
    """The ground from above, sRGB uint8."""
    half = np.array([field.hx, field.hy])
    pixel = max(2.0 * half.max() / _GROUND_PIXELS, _GROUND_PIXEL)
    columns, rows = np.maximum(np.ceil(2.0 * half / pixel), 1.0).astype(int)
    data = np.asarray(field.data, dtype=np.float32).reshape(field.nrow, field.ncol)
    heights = float(pose[2]) + field.min_z + data * (field.max_z - field.min_z)
    picture = wp.empty((int(rows), int(columns)), dtype=wp.vec3f, device="cpu")
    colors = wp.array(np.ascontiguousarray(field.colors, dtype=np.float32), dtype=wp.vec3f, device="cpu")
    inputs = [
        colors,
        wp.array(heights, dtype=wp.float32, device="cpu"),
        wp.vec2f(*map(float, pose[:2] - half)),
        wp.vec2f(*map(float, 2.0 * half)),
    ]
    wp.launch(draw_ground, dim=picture.shape, inputs=inputs, outputs=[picture], device="cpu")
    linear = np.clip(_SOIL_GAIN * picture.numpy(), 0.0, 1.0)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.round(255.0 * srgb).astype(np.uint8)
