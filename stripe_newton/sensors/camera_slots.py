# SPDX-License-Identifier: Apache-2.0
"""Camera slots: the shapes that the pictures of each environment list, and the meshes that rays meet for them.

Meshes of one body that nothing collides with are one slot: a robot's link of twenty meshes then costs a ray one search
instead of twenty. Each mesh has coarser versions, see :mod:`.mesh_levels`, and trees of bounds that are better than
those which physics builds in a hurry.
"""

from __future__ import annotations

from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from stripe_kernels.sensors.camera_shapes import MeshLevel, SeenShapes

from .mesh_levels import Triangles, coarser_versions, join

__all__ = ["MESH_KINDS", "CameraSlots", "MeshTable"]

MESH_KINDS = [int(kind) for kind in (newton.GeoType.MESH, newton.GeoType.CONVEX_MESH, newton.GeoType.HFIELD)]
_LEAF = 2
"""Triangles of a leaf: rays want few."""
_MOST_REBUILT = 1_000_000
"""Number of triangles above which a mesh keeps the tree that it has: another one takes seconds."""


class MeshTable:
    """Versions of meshes, as kernels look them up; those of a mesh follow each other, the finest first.

    Attributes:
        faces: Numbers of triangles by row.
    """

    def __init__(self, device: wp.Device):
        self._device = device
        self.faces: list[int] = []
        self._levels: list[MeshLevel] = []
        self._kept: list[wp.Mesh] = []  # whose memory the structs point to, as they do to that of their own arrays

    def as_is(self, pointer: int, source: object) -> int:
        """Add a mesh with the tree that it has; returns its row."""
        level = self._level(int(pointer), 0.0, source.normals if isinstance(source, newton.Mesh) else None, None)
        self._levels.append(level)
        self.faces.append(len(source.indices) // 3 if isinstance(source, newton.Mesh) else 0)
        return len(self._levels) - 1

    def add(self, parts: list[Triangles], offsets: np.ndarray | None, coarser: bool) -> tuple[int, int]:
        """Add a mesh, and its coarser versions; returns its first and its last row.

        Args:
            parts: The meshes that it consists of.
            offsets: Index of the shape of each part, less that of the slot; None for a single shape.
            coarser: Whether to make coarser versions.
        """
        first = len(self._levels)
        for version in [join(parts), *(coarser_versions(parts, self._device) if coarser else [])]:
            points = wp.array(version.vertices.astype(np.float32), dtype=wp.vec3, device=self._device)
            faces = wp.array(version.faces.reshape(-1).astype(np.int32), dtype=int, device=self._device)
            tree = wp.Mesh(points, faces, bvh_constructor="sah", bvh_leaf_size=_LEAF)
            self._kept.append(tree)
            self.faces.append(len(version.faces))
            parts = None if offsets is None else offsets[version.part]
            self._levels.append(self._level(int(tree.id), version.error, version.normals, parts))
        return first, len(self._levels) - 1

    def _level(self, mesh: int, error: float, normals: np.ndarray | None, parts: np.ndarray | None) -> MeshLevel:
        level = MeshLevel()
        level.mesh, level.error = wp.uint64(mesh), error
        vectors = np.zeros((0, 3)) if normals is None else np.asarray(normals).reshape(-1, 3)
        level.normals = wp.array(vectors.astype(np.float32), dtype=wp.vec3, device=self._device)
        index = np.zeros(0, dtype=np.int32) if parts is None else parts.astype(np.int32)
        level.part = wp.array(index, dtype=int, device=self._device)
        return level

    def array(self) -> wp.array:
        """The rows, for kernels. The table must live as long."""
        return wp.array(self._levels, dtype=MeshLevel, device=self._device)

    def mesh(self, row: int) -> int:
        """Id of the mesh of a row."""
        return int(self._levels[row].mesh)


@dataclass
class _Rows:
    """Shapes of the environments.

    Attributes:
        index: Those of each environment, indices into the model.
        groups: Columns that are one slot, where all environments have the same shapes in the same order; the slot is
            the first one's.
    """

    index: list[np.ndarray]
    groups: list[np.ndarray]


class CameraSlots:
    """Slots of the shapes that each environment's pictures list.

    Attributes:
        seen: The slots.
        table: Versions of their meshes.
        merged: Shapes of an environment that are within the slots of others.
    """

    def __init__(self, model: newton.Model, seen: np.ndarray, shared: np.ndarray, detail: float):
        """Make the slots.

        Args:
            model: The model.
            seen: Shapes of environments, indices into the model.
            shared: Shapes that every environment lists.
            detail: Largest share of a pixel by which surfaces may move; 0 to keep every mesh as it is.
        """
        self._model, self._detail = model, detail
        self._kinds, self._scales = model.shape_type.numpy(), model.shape_scale.numpy().astype(np.float64)
        self._poses = model.shape_transform.numpy().astype(np.float64)
        self.table = MeshTable(model.device)
        rows = self._rows(seen)
        self.merged = sum(len(group) - 1 for group in rows.groups)
        kept = (
            np.setdiff1d(np.arange(len(rows.index[0])), [c for g in rows.groups for c in g[1:]])
            if rows.groups
            else None
        )
        own = rows.index if kept is None else [row[kept] for row in rows.index]
        self.seen = self._slots([np.concatenate([row, shared]) for row in own])
        self._assign_meshes(rows, kept)

    def _rows(self, seen: np.ndarray) -> _Rows:
        """Shapes by environment, and which of them are one slot."""
        model = self._model
        worlds = model.shape_world.numpy()[seen]
        order = np.argsort(worlds, kind="stable")
        count = np.bincount(worlds, minlength=model.world_count)
        rows = np.split(seen[order], np.cumsum(count)[:-1])
        if self._detail <= 0.0 or len(set(count.tolist())) != 1 or not count[0]:
            return _Rows(rows, [])
        table = np.stack(rows)
        body, flags = model.shape_body.numpy(), model.shape_flags.numpy()
        kinds, first = self._kinds, table[0]
        free = (kinds[first] == int(newton.GeoType.MESH)) & (body[first] >= 0)
        free &= (flags[first] & int(newton.ShapeFlags.COLLIDE_SHAPES)) == 0
        columns = np.flatnonzero(free & [isinstance(model.shape_source[i], newton.Mesh) for i in first])
        sources = np.array([[id(model.shape_source[i]) for i in row] for row in table[:, columns]])
        index = table[:, columns]
        values = (
            index - index[:, :1],
            body[index] - body[index[:, :1]],
            sources,
            self._poses[index],
            self._scales[index],
        )
        if not columns.size or not all((value == value[:1]).all() for value in values):
            return _Rows(rows, [])
        lit = [model.shape_source[i].normals is not None for i in first[columns]]
        keys = 2 * body[first[columns]] + np.array(lit, dtype=int)
        groups = [columns[keys == key] for key in np.unique(keys)]
        return _Rows(rows, [group for group in groups if len(group) > 1])

    def _slots(self, rows: list[np.ndarray]) -> SeenShapes:
        """Arrays of the slots; ``rows`` are the shapes of each environment."""
        model, seen = self._model, SeenShapes()
        index = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
        count = len(index)
        seen.first = wp.array(np.cumsum([0, *map(len, rows)]).astype(np.int32), dtype=int)
        seen.env = wp.array(np.repeat(np.arange(len(rows)), list(map(len, rows))).astype(np.int32), dtype=int)
        seen.shape = wp.array(index.astype(np.int32), dtype=int)
        seen.kind = wp.array(self._kinds[index].astype(np.int32), dtype=int)
        is_mesh = np.isin(self._kinds[index], MESH_KINDS)
        bounds = model.bvh_shape_bounds.numpy() if count else np.zeros((0, 2, 3), dtype=np.float32)
        self._index, self._is_mesh = index, is_mesh
        self._boxes = np.where(is_mesh[:, None, None], bounds[index], 0.0)
        kinds_of = {"turn": wp.mat33, "start": wp.vec3, "size": wp.vec3, "albedo": wp.vec3, "nearest": float}
        kinds_of |= {"pixels": wp.vec4i, "sphere": wp.vec4, "listed": int, "level": int}
        for name, dtype in kinds_of.items():
            setattr(seen, name, wp.zeros(count, dtype=dtype))
        seen.count = wp.zeros(len(rows), dtype=int)
        return seen

    def _assign_meshes(self, rows: _Rows, kept: np.ndarray | None) -> None:
        """Give each slot the versions of its mesh."""
        model, index = self._model, self._index
        versions = np.full((len(index), 2), -1, dtype=np.int32)
        first = self.seen.first.numpy()
        merged = np.zeros(len(index), dtype=bool)
        for group in rows.groups:
            parts, offsets = self._parts(rows.index[0][group])
            slots = first[:-1] + int(np.searchsorted(kept, group[0]))
            versions[slots] = self.table.add(parts, offsets, self._detail > 0.0)
            self._boxes[slots] = _bounds(parts)
            merged[slots] = True
        pointers = model.shape_source_ptr.numpy()
        known: dict[tuple[int, int], tuple[int, int]] = {}
        for slot in np.flatnonzero(self._is_mesh & ~merged):
            # Meshes of the same triangles have one tree in the model, but normals of their own.
            shape = index[slot]
            key = id(model.shape_source[shape]), int(self._kinds[shape])
            if key not in known:
                known[key] = self._versions(shape, pointers[shape])
            versions[slot] = known[key]
        ids = np.array([0, *(self.table.mesh(row) for row in range(versions.max(initial=-1) + 1))], dtype=np.uint64)
        self.seen.mesh = wp.array(ids[versions[:, 0] + 1], dtype=wp.uint64)
        self.seen.versions = wp.array(versions, dtype=wp.vec2i)
        self.seen.level = wp.array(versions[:, 0].copy(), dtype=int)
        self.seen.box = wp.array(self._boxes, dtype=wp.vec3, shape=(len(index), 2))

    def _versions(self, shape: int, pointer: int) -> tuple[int, int]:
        """Rows of the table for a shape's mesh."""
        source = self._model.shape_source[shape]
        plain = isinstance(source, newton.Mesh) and self._kinds[shape] == int(newton.GeoType.MESH)
        if not plain or len(source.indices) > 3 * _MOST_REBUILT:
            # A hull has vertices of its own, to which the normals of its mesh do not belong.
            row = self.table.as_is(pointer, source if plain else None)
            return row, row
        return self.table.add([_triangles(source)], None, self._detail > 0.0)

    def _parts(self, shapes: np.ndarray) -> tuple[list[Triangles], np.ndarray]:
        """Meshes of several shapes in the frame of the first one, before it is scaled; and offsets of their indices."""
        from scipy.spatial.transform import Rotation  # here, as it takes long to import

        place, turn = self._poses[shapes[0], :3], Rotation.from_quat(self._poses[shapes[0], 3:])
        scale, parts = self._scales[shapes[0]], []
        for shape in shapes:
            part = _triangles(self._model.shape_source[shape])
            relative = turn.inv() * Rotation.from_quat(self._poses[shape, 3:])
            moved = turn.inv().apply(self._poses[shape, :3] - place)
            if part.normals is not None:
                normals = relative.apply(part.normals / self._scales[shape]) * scale
                part.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1.0e-12)
            part.vertices = (relative.apply(part.vertices * self._scales[shape]) + moved) / scale
            parts.append(part)
        return parts, shapes - shapes[0]


def _bounds(parts: list[Triangles]) -> np.ndarray:
    """Box around meshes, shape ``(2, 3)``."""
    vertices = np.concatenate([part.vertices for part in parts])
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def _triangles(source: newton.Mesh) -> Triangles:
    """Triangles of a mesh of Newton."""
    faces = np.asarray(source.indices).reshape(-1, 3)
    normals = None if source.normals is None else np.asarray(source.normals, dtype=np.float64).reshape(-1, 3)
    vertices = np.asarray(source.vertices, dtype=np.float64).reshape(-1, 3)
    return Triangles(vertices, faces, normals, np.zeros(len(faces), dtype=np.int64))
