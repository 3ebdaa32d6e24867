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
_SOFT = "so that what holds it is softer or stiffer"


def constant_rows(builder: newton.ModelBuilder, first_shape: int, model: mujoco.MjModel) -> list[Row]:
    """Rows of inverse weights, which set how soft constraints are, and of hulls, that are not those of MuJoCo.

    Args:
        builder: The builder that the file was added to.
        first_shape: Number of shapes before.
        model: MuJoCo's model of the file.
    """
    return [*_weights_of_slides(model), *_weights_without_mass(model), *_weights_of_refs(model),
            *_simpler_hulls(builder, first_shape, model)]  # fmt: skip


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
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    used = model.geom_dataid[collides & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)]
    for mesh in np.unique(used):
        corners = int(model.mesh_graph[model.mesh_graphadr[mesh]]) if model.mesh_graphadr[mesh] >= 0 else 0
        if corners > max(limits):
            why = (
                f"has {corners} corners in MuJoCo, {max(limits)} here; max_hull_vertices=-1 keeps all, and takes longer"
            )
            yield model.mesh(int(mesh)).name or f"mesh {mesh}", "convex hull", why
