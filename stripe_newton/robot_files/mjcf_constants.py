# SPDX-License-Identifier: Apache-2.0
"""MJCF constants: what Newton's conversion to MuJoCo computes otherwise than MuJoCo's compiler, for the report."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import newton
import numpy as np
from newton import GeoType, ShapeFlags

from .urdf_checks import Row

__all__ = ["constant_rows"]

_SLIDES_ALONE = 2
"""MuJoCo's ``body_simple`` of a body that only slides."""
_CENTRES_APART = 1e-3
"""Share of a mesh's size by which its centres of surface and volume are apart at least, for a row."""
_SOFT = "so that what holds it is softer or stiffer"


def constant_rows(builder: newton.ModelBuilder, first_shape: int, model: mujoco.MjModel) -> list[Row]:
    """Rows of inverse weights, which set how soft constraints are, hulls and centres of meshes that MuJoCo has others.

    Args:
        builder: The builder that the file was added to.
        first_shape: Number of shapes before.
        model: MuJoCo's model of the file.
    """
    return [*_weights_of_slides(model), *_weights_without_mass(model), *_weights_of_refs(model),
            *_simpler_hulls(builder, first_shape, model), *_centres_of_meshes(model)]  # fmt: skip


def _weights_of_slides(model: mujoco.MjModel) -> Iterator[Row]:
    for body in np.flatnonzero((model.body_simple == _SLIDES_ALONE) & (model.body_dofnum < 3)):
        share = model.body_dofnum[body] / 3.0
        why = f"it only slides: MuJoCo takes 1/mass, Newton {share:.2g} of that, the mean of three axes, {_SOFT}"
        yield model.body(body).name or f"body {body}", "inverse weight", why


def _weights_without_mass(model: mujoco.MjModel) -> Iterator[Row]:
    held = _held_bodies(model)
    for body in range(1, model.nbody):
        offset = np.abs(model.body_ipos[body]).max()
        if model.body_mass[body] == 0.0 and model.body_weldid[body] and offset > 1e-6 and body in held:
            why = f"it has no mass: MuJoCo takes that of the middle of its shapes, Newton that of its origin, {_SOFT}"
            yield model.body(body).name or f"body {body}", "inverse weight", why


def _held_bodies(model: mujoco.MjModel) -> set[int]:
    """Bodies that constraints hold: by contacts, or by equalities of two bodies or sites."""
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    held = {int(body) for body in model.geom_bodyid[collides]}
    sites = int(mujoco.mjtObj.mjOBJ_SITE)
    for e in range(model.neq):
        if int(model.eq_type[e]) in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            objects = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            held |= {int(model.site_bodyid[o]) if model.eq_objtype[e] == sites else o for o in objects}
    return held


def _weights_of_refs(model: mujoco.MjModel) -> Iterator[Row]:
    single = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
    shifted = single & (model.qpos0[model.jnt_qposadr] != 0.0)
    if shifted.any():
        name = model.joint(int(np.flatnonzero(shifted)[0])).name
        more = f" (+{int(shifted.sum()) - 1} more)" if shifted.sum() > 1 else ""
        why = f"MuJoCo takes them with this joint at its ref, Newton at 0, {_SOFT}"
        yield name + more, "inverse weights", why


def _simpler_hulls(builder: newton.ModelBuilder, first_shape: int, model: mujoco.MjModel) -> Iterator[Row]:
    limits = [
        int(builder.shape_source[shape].maxhullvert)
        for shape in range(first_shape, builder.shape_count)
        if builder.shape_type[shape] in (GeoType.MESH, GeoType.CONVEX_MESH)
        and builder.shape_flags[shape] & ShapeFlags.COLLIDE_SHAPES
    ]
    if not limits or min(limits) < 0:
        return
    corners = {
        mesh: int(model.mesh_graph[model.mesh_graphadr[mesh]])
        for mesh in (int(m) for m in np.unique(model.geom_dataid[_mesh_colliders(model)]))
        if model.mesh_graphadr[mesh] >= 0
    }
    if more := [mesh for mesh, count in corners.items() if count > max(limits)]:
        most = max(corners[mesh] for mesh in more)
        why = (
            f"has {'up to ' * (len(more) > 1)}{most} corners in MuJoCo, {max(limits)} here; max_hull_vertices=-1 keeps "
        )
        why += "all, and takes longer"
        for mesh in more:
            yield model.mesh(mesh).name or f"mesh {mesh}", "convex hull", why


def _mesh_colliders(model: mujoco.MjModel) -> np.ndarray:
    """Which shapes are meshes that collide, shape ``(ngeom,)``."""
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    return collides & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)


def _centres_of_meshes(model: mujoco.MjModel) -> Iterator[Row]:
    """Meshes that Newton's solver puts about another point: the search for contacts of two meshes starts there.

    It ends at the same points where they touch. Deep inside each other hulls have several pairs of faces that are
    nearly as deep, and it may end at another one.
    """
    colliders = _mesh_colliders(model)
    if len(np.unique(model.body_weldid[model.geom_bodyid[colliders]])) < 2:
        return
    for mesh in np.unique(model.geom_dataid[colliders]):
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        points = model.mesh_vert[first : first + count].astype(float)
        first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        corners = points[model.mesh_face[first : first + count]]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        if not areas.sum() > 0.0:
            continue
        centre = areas @ corners.mean(axis=1) / areas.sum()  # from that of MuJoCo, which is the mesh's origin
        if np.linalg.norm(centre) > _CENTRES_APART * np.ptp(points, axis=0).max():
            why = "Newton's is that of the surface, MuJoCo's that of the volume: where it is deep in another mesh, the "
            why += "search for their contacts starts there and may find others"
            yield model.mesh(int(mesh)).name or f"mesh {mesh}", "centre of the mesh", why
