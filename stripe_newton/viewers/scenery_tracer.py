# SPDX-License-Identifier: Apache-2.0
"""Scenery tracer: rays against large numbers of static meshes, such as the trees of a forest."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import newton
import numpy as np
import warp as wp
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.spatial.transform import Rotation

from stripe_kernels.picture_leaves import LeafStyle
from stripe_kernels.picture_scenery import (
    FOLIAGE,
    GROUND,
    PLAIN,
    SMOOTH,
    SOLID,
    SceneryMeshes,
    scenery_distances,
    trace_scenery,
)

from .leaf_meshes import LEAF_STYLES, leaf_mesh, leaf_styles

if TYPE_CHECKING:
    from stripe_kernels.picture_light import Look

    from .display_model import DisplayModel

__all__ = ["SceneryTracer"]

_FAR = 30_000.0
"""Length of the rays [m]."""
_SUN_SPREAD = 0.005
"""Half the angle of the sun with the halo around it, for the softness of shadows [rad]."""
_MIRROR_ROUGHNESS = 0.25
"""Roughness below which a mesh mirrors the sky."""
_CELL = 2.0
"""Side of a cell of the canopy map [m]."""
_PIECES = 4
"""Pieces of a picture per thread, so that no thread waits long for another."""
_MIN_RAYS_FOR_THREADS = 4096
"""Number of rays from which a picture is shared by several threads."""


class SceneryTracer:
    """Traces the scenery of a display model: static meshes and height fields.

    It does what Newton's camera sensor cannot: shadows ray by ray, and leaves that let light through. On the CPU, as
    many threads as there are cores share a picture.

    Args:
        scene: The display model; its ``scenery`` names the shapes.
    """

    def __init__(self, scene: DisplayModel):
        model, index = scene.model, scene.scenery
        self._device = model.device
        self._sources = [scene.sources[i] for i in index]
        bounds = np.array([_bounds(s) for s in self._sources])
        pose = model.shape_transform.numpy()[index]
        scale = model.shape_scale.numpy()[index]
        fields = np.array([isinstance(s, newton.Heightfield) for s in self._sources])
        scale[fields] = 1.0  # Newton keeps the extent of a height field in the source, not in the scale
        # scene/scenery.py marks meshes with double-sided triangles as leaves; Newton's Mesh knows no such thing.
        leaves = np.array([bool(getattr(s, "two_sided", False)) for s in self._sources])
        styles = list(LEAF_STYLES)
        foliage = np.array([styles.index(getattr(s, "foliage", "")) for s in self._sources], dtype=int)
        margins = np.array([fields.get("margin", 0.0) for fields in LEAF_STYLES.values()])[foliage]
        bounds += margins[:, None, None] * np.array([[-2.0], [2.0]])  # corners move farther than edges
        # One hierarchy over the boxes of all shapes; inside a box the ray meets the mesh's own hierarchy.
        lower, upper = _boxes(bounds, pose, scale)
        make = {"device": self._device}
        self._bvh = wp.Bvh(wp.array(lower, dtype=wp.vec3, **make), wp.array(upper, dtype=wp.vec3, **make))
        self._meshes = meshes = SceneryMeshes()
        meshes.bvh, meshes.far = self._bvh.id, _FAR
        pointers = model.shape_source_ptr.numpy()[index]
        for i in np.flatnonzero(foliage):
            pointers[i] = leaf_mesh(self._sources[i], self._device).id
        meshes.mesh = wp.array(pointers, dtype=wp.uint64, **make)
        meshes.foliage = wp.array(foliage.astype(np.int32), dtype=wp.int32, **make)
        meshes.leaf = wp.array(leaf_styles(), dtype=LeafStyle, **make)
        meshes.pose = wp.array(pose, dtype=wp.transformf, **make)
        meshes.scale = wp.array(scale, dtype=wp.vec3f, **make)
        meshes.shape = wp.array(index.astype(np.int32), dtype=wp.int32, **make)
        smooth = np.array([(getattr(s, "roughness", None) or 1.0) < _MIRROR_ROUGHNESS for s in self._sources])
        # Meshes of scene/scenery.py alone say whether they are leaves: they are nature, and all others are made.
        grown = np.array([hasattr(s, "two_sided") for s in self._sources], dtype=bool)
        # The first that applies: a leaf may be smooth, too.
        around = np.array([hasattr(s, "surround") for s in self._sources], dtype=bool)
        kinds = [(fields | around, GROUND), (leaves, FOLIAGE), (smooth, SMOOTH), (grown, SOLID)]
        kind = np.select([of for of, _ in kinds], [int(kind) for _, kind in kinds], PLAIN).astype(np.int32)
        meshes.kind = wp.array(kind, dtype=wp.int32, **make)
        meshes.color = wp.array(scene.colors[index].astype(np.float32), dtype=wp.vec3f, **make)
        meshes.middle = wp.array(bounds.mean(axis=1).astype(np.float32), dtype=wp.vec3f, **make)
        # Not 0: places in a mesh are taken relative to its size, and a flat mesh has none along one axis.
        half = np.maximum(0.5 * (bounds[:, 1] - bounds[:, 0]), 1.0e-3)
        meshes.half = wp.array(half.astype(np.float32), dtype=wp.vec3f, **make)
        self._ground(pose[fields])
        self._canopy(lower[~around], upper[~around], leaves[~around])
        self._threads = (os.cpu_count() or 1) if self._device.is_cpu else 1

    def trace(self, look: Look, rays: wp.array, casters: wp.array, images: dict[str, wp.array]) -> None:
        """Add the scenery to the ``images`` depth, shape, normal and detail of rays, shape (n, 2)."""
        count = len(rays)
        buffers = [images[k] for k in ("depth", "shape", "normal", "detail")]

        def piece(first: int, last: int) -> None:
            args = [look, self._meshes, first, _SUN_SPREAD, rays, casters, *buffers]
            wp.launch(trace_scenery, dim=last - first, inputs=args, device=self._device)

        if self._threads == 1 or count < _MIN_RAYS_FOR_THREADS:
            piece(0, count)
            return
        # Loaded before the threads start: each of them would load, and maybe compile, it otherwise.
        wp.load_module(trace_scenery.module.name, device=self._device)
        # Warp's launches release the GIL while they run on the CPU, so threads do share the work.
        cuts = np.linspace(0, count, self._threads * _PIECES + 1).astype(int).tolist()
        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(piece, cuts[:-1], cuts[1:]))

    def distances(self, origins: np.ndarray, directions: np.ndarray, limit: float) -> np.ndarray:
        """Free distance from each origin (n, 3) along each unit direction (m, 3), shape (n, m), up to ``limit`` [m]."""
        rays = [wp.array(a.astype(np.float32), dtype=wp.vec3f, device=self._device) for a in (origins, directions)]
        out = wp.empty(len(origins) * len(directions), dtype=wp.float32, device=self._device)
        args = [self._meshes, *rays, limit, out]
        wp.launch(scenery_distances, dim=(len(origins), len(directions)), inputs=args, device=self._device)
        return out.numpy().reshape(len(origins), len(directions))

    def air_at(self, eye: np.ndarray) -> float:
        """Brightness of the haze around a camera: 1 in the open, 0.35 under a closed canopy."""
        column, row = ((eye[:2] - self._corner) // _CELL).astype(int)
        if not (0 <= row < self._cover.shape[0] and 0 <= column < self._cover.shape[1]):
            return 1.0
        return float(1.0 - 0.65 * self._cover[row, column] * np.clip((self._top[row, column] - eye[2]) / 8.0, 0.0, 1.0))

    def _ground(self, poses: np.ndarray) -> None:
        """Copy the colours of the height field that has any."""
        meshes, found = self._meshes, None
        for source in self._sources:
            if isinstance(source, newton.Heightfield) and getattr(source, "colors", None) is not None:
                found = source
        if found is None:
            meshes.ground_color = wp.zeros((0, 0), dtype=wp.vec3f, device=self._device)
            return
        middle = poses[0][:2]
        rows, columns = found.colors.shape[:2]
        colors = np.ascontiguousarray(found.colors, dtype=np.float32)
        meshes.ground_color = wp.array(colors, dtype=wp.vec3f, device=self._device)
        meshes.ground_mean = wp.vec3f(*map(float, colors.mean(axis=(0, 1))))
        meshes.ground_lower = wp.vec2f(float(middle[0] - found.hx), float(middle[1] - found.hy))
        meshes.ground_cell = wp.vec2f(2.0 * found.hx / (columns - 1), 2.0 * found.hy / (rows - 1))

    def _canopy(self, lower: np.ndarray, upper: np.ndarray, leaves: np.ndarray) -> None:
        """Make a map of the share of the sky that leaves hide, and of the height of the leaves."""
        corner = lower[:, :2].min(axis=0)
        shape = np.ceil((upper[:, :2].max(axis=0) - corner) / _CELL).astype(int)[::-1] + 1
        cover, top = np.zeros(shape), np.full(shape, -1.0e3)
        crowns = leaves & (upper[:, 2] - lower[:, 2] > 2.0)  # lower leaves are undergrowth
        middle = 0.5 * (lower + upper)[crowns, :2] - corner
        radius = 0.25 * (upper - lower)[crowns, :2].sum(axis=1)
        reach = int(np.ceil(min(radius.max(initial=0.0), 12.0) / _CELL))
        # A loop over the cells of the largest crown, each time for all crowns at once.
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                column, row = (middle // _CELL).astype(int).T + np.array([[dx], [dy]])
                at = (np.stack([column, row], axis=1) + 0.5) * _CELL
                inside = np.linalg.norm(at - middle, axis=1) < 0.9 * radius + 0.3 * _CELL
                inside &= (row >= 0) & (column >= 0) & (row < shape[0]) & (column < shape[1])
                np.add.at(cover, (row[inside], column[inside]), 1.0)
                np.maximum.at(top, (row[inside], column[inside]), upper[crowns, 2][inside])
        cover = gaussian_filter(1.0 - np.exp(-0.9 * cover), 1.0)  # crowns above one another: Beer's law
        top = maximum_filter(top, 5)
        self._cover, self._top, self._corner = cover, top, corner
        both = np.stack([cover, top], axis=-1).astype(np.float32)
        self._meshes.canopy = wp.array(both, dtype=wp.vec2f, device=self._device)
        self._meshes.canopy_lower = wp.vec2f(*map(float, corner))
        self._meshes.canopy_cell = _CELL


def _bounds(source: newton.Mesh | newton.Heightfield) -> np.ndarray:
    """Lower and upper corner of a mesh or height field in its own frame [m], shape (2, 3)."""
    if isinstance(source, newton.Heightfield):
        return np.array([[-source.hx, -source.hy, source.min_z], [source.hx, source.hy, source.max_z]])
    # Kept on the mesh itself: it is shared by thousands of shapes, and by the renderers of several pictures.
    known = getattr(source, "_box", None)
    if known is None:
        points = np.asarray(source.vertices, dtype=float)
        known = source._box = np.stack([points.min(axis=0), points.max(axis=0)])
    return known


def _boxes(bounds: np.ndarray, pose: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World-aligned boxes around scaled and posed boxes: lower and upper corners [m], shapes (n, 3)."""
    middle, half = bounds.mean(axis=1) * scale, 0.5 * (bounds[:, 1] - bounds[:, 0]) * scale
    turn = Rotation.from_quat(pose[:, 3:]).as_matrix()
    at = pose[:, :3] + np.einsum("nij,nj->ni", turn, middle)
    reach = np.einsum("nij,nj->ni", np.abs(turn), half) + 1.0e-3
    return (at - reach).astype(np.float32), (at + reach).astype(np.float32)
