# SPDX-License-Identifier: Apache-2.0
"""Static triangles: the triangles of colliders that do not move, which the fused step finds contacts with."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Sequence

import mujoco
import newton
import numpy as np
import warp as wp

from stripe_newton.shape_mesh import shape_mesh

from .contact_pairs import MESH_KINDS, ContactPair
from .mesh_grid import DEPTH, MeshGrids, TriangleMesh
from .stand_ins import StandIns
from .static_meshes import MUST, marks_of

__all__ = ["StaticTriangles"]

_MOST_RADIUS = 0.15
"""Radius of geoms that look into one cell of a grid of meshes; larger ones look into several [m]."""


class StaticTriangles:
    """Groups of static meshes that meet the same geoms in the same way, with their triangles on the device.

    A pair of such a group and a geom stands for the pairs of all its meshes with that geom. The group is in the frame
    of the mesh that is the first geom of the pair.

    Attributes:
        pairs: Pairs of geoms that may touch, in which those of groups replace those of their meshes and have the group
            as their ``mesh``.
        unsupported: Pairs of concave meshes with geoms that the kernel has no routine for.
        grids: The triangles of the groups; None without one.
        hidden_geoms: The geom that stands for each shape that is none; None without such shapes.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        newton_model: newton.Model,
        shape_of_geom: np.ndarray,
        pairs: Sequence[ContactPair],
        stand_ins: StandIns | None,
    ):
        """Group the static meshes that are marked.

        Args:
            model: The compiled model.
            newton_model: The model that it was compiled from.
            shape_of_geom: Newton's shape of each geom, -1 for none, shape ``(ngeom,)``.
            pairs: Pairs of geoms that may touch.
            stand_ins: Shapes that are no geoms.
        """
        self._shapes, self._stand_ins = _Shapes(newton_model), stand_ins
        self.pairs: list[ContactPair] = []
        self.unsupported: list[ContactPair] = []
        self.hidden_geoms: wp.array | None = None
        by_geom = self._pairs_by_mesh(model, shape_of_geom, pairs)
        hidden = self._hidden(model, shape_of_geom, stand_ins) if stand_ins is not None else {}
        groups: dict[tuple, list[int]] = defaultdict(list)
        for geom, own in sorted(by_geom.items()):
            met = frozenset((p.geom2, p.kind, p.dim, p.rule) for p in own)
            world = int(self._shapes.world[shape_of_geom[geom]])
            groups[world, float(model.geom_margin[geom]), met].append(geom)
        meshes: list[list[TriangleMesh]] = []
        for geoms in groups.values():
            self.pairs += [dataclasses.replace(pair, mesh=len(meshes)) for pair in by_geom[geoms[0]]]
            members = [m for g in geoms for m in ((g, int(shape_of_geom[g])), *hidden.get(g, ()))]
            meshes.append([self._shapes.in_frame_of(model, geoms[0], g, shape) for g, shape in members])
        reach = min(_largest_radius(model, by_geom), _MOST_RADIUS) + DEPTH
        self.grids = MeshGrids(meshes, reach, newton_model.device) if meshes else None

    def _pairs_by_mesh(
        self, model: mujoco.MjModel, shape_of_geom: np.ndarray, pairs: Sequence[ContactPair]
    ) -> dict[int, list[ContactPair]]:
        """Pairs of static meshes by their geom, which comes first in them; the others are kept as they are."""
        shapes, by_geom = self._shapes, defaultdict[int, list[ContactPair]](list)
        wanted = {
            g
            for g, shape in enumerate(shape_of_geom.tolist())
            if shape >= 0 and shapes.mark[shape] and shapes.body[shape] < 0 and model.geom_bodyid[g] == 0
        }
        for pair in pairs:
            geom = next((g for g in (pair.geom1, pair.geom2) if g in wanted), -1)
            if geom < 0 or pair.explicit >= 0:
                self.pairs.append(pair)
                continue
            rule = pair.rule
            if geom == pair.geom2:
                rule = {"OF_FIRST": "OF_SECOND", "OF_SECOND": "OF_FIRST"}.get(rule, rule)
            other = pair.geom2 if geom == pair.geom1 else pair.geom1
            kind = MESH_KINDS.get(int(model.geom_type[other]))
            if kind is None:
                self.pairs.append(pair)
                if shapes.mark[shape_of_geom[geom]] == MUST:
                    self.unsupported.append(pair)
                continue
            by_geom[geom].append(ContactPair(geom, other, kind, pair.dim, rule))
        return by_geom

    def _hidden(
        self, model: mujoco.MjModel, shape_of_geom: np.ndarray, stand_ins: StandIns
    ) -> dict[int, list[tuple[int, int]]]:
        """Indices, as of geoms, and shapes of those that are no geoms, by the geom that represents them."""
        geoms, found = stand_ins.geoms(shape_of_geom), defaultdict[int, list[tuple[int, int]]](list)
        self.hidden_geoms = wp.array(geoms, dtype=int, device=self._shapes.device)
        for k, (geom, shape) in enumerate(zip(geoms.tolist(), stand_ins.hidden.tolist(), strict=True)):
            found[geom].append((model.ngeom + k, shape))
        return found

    def check_unchanged(self, newton_model: newton.Model) -> None:
        """Refuse that a static mesh has moved since its triangles were sorted into the grids, or has another material.

        Raises:
            ValueError: naming the shape.
        """
        changed = np.zeros(0, dtype=int) if self._stand_ins is None else self._stand_ins.mismatched(newton_model)
        if len(changed):
            raise ValueError(
                f"the material of the static collider '{self._shapes.label[changed[0]]}' was changed, but of so many "
                "static colliders those of a material share one: change all of them alike, or author it in the stage"
            )
        if self.grids is None:
            return
        marked = (self._shapes.mark > 0) & (self._shapes.body < 0)
        now = _Shapes(newton_model)
        for name in ("pose", "scale"):
            moved = marked & (getattr(now, name) != getattr(self._shapes, name)).any(axis=1)
            if moved.any():
                label = self._shapes.label[int(np.flatnonzero(moved)[0])]
                what = "was moved" if name == "pose" else "has another size"
                raise ValueError(
                    f"the static collider '{label}' {what}, but its triangles stay where they were when the scene was "
                    "built: give it a rigid body with kinematicEnabled, or build the scene anew"
                )


class _Shapes:
    """Shapes of a model on the host."""

    def __init__(self, model: newton.Model):
        self.mark, self.device = marks_of(model), model.device
        self.body, self.world, self.type = (a.numpy() for a in (model.shape_body, model.shape_world, model.shape_type))
        self.scale, self.pose = (a.numpy().astype(float) for a in (model.shape_scale, model.shape_transform))
        self.source, self.label = model.shape_source, model.shape_label

    def in_frame_of(self, model: mujoco.MjModel, frame: int, geom: int, shape: int) -> TriangleMesh:
        """Triangles of a static shape in the frame of a geom of the world."""
        vertices, faces = shape_mesh(self.type[shape], self.scale[shape], self.source[shape], self.label[shape])
        x, y, z, w = self.pose[shape, 3:]
        world = vertices @ _matrix(np.array([w, x, y, z])).T + self.pose[shape, :3]
        return TriangleMesh((world - model.geom_pos[frame]) @ _matrix(model.geom_quat[frame]), faces, geom)


def _matrix(quat: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat / np.linalg.norm(quat))
    return matrix.reshape(3, 3)


def _largest_radius(model: mujoco.MjModel, by_geom: dict[int, list[ContactPair]]) -> float:
    """Largest radius of the balls and capsules that meet meshes, with their margins [m]."""
    met = {p.geom2 for own in by_geom.values() for p in own if p.kind != MESH_KINDS[mujoco.mjtGeom.mjGEOM_BOX]}
    return max((float(model.geom_size[g, 0]) for g in met), default=0.0) + model.geom_margin.max(initial=0.0) * 2.0
