# SPDX-License-Identifier: Apache-2.0
"""MJCF visibility: colliders that MuJoCo draws are drawn, too, in a file that also has geoms without collisions."""

from __future__ import annotations

import mujoco
import newton

from .mjcf_masses import bodies_of_file

__all__ = ["show_drawn_colliders"]

_DRAWN_GROUPS = 3
"""MuJoCo's viewer draws geoms of the groups 0 to 2. Files put what is only for collisions into others."""
_COLLIDE, _VISIBLE = int(newton.ShapeFlags.COLLIDE_SHAPES), int(newton.ShapeFlags.VISIBLE)


def show_drawn_colliders(
    builder: newton.ModelBuilder, first_body: int, first_shape: int, model: mujoco.MjModel
) -> None:
    """Show the colliders of a file as MuJoCo does, but for bodies that have a mesh to be seen.

    Newton's importer hides all colliders as soon as one geom of the file does not collide: of a robot with a
    decoration only that was left. Where a body has a mesh without collisions, its colliders are approximations of it.

    Args:
        builder: The builder that the file was added to.
        first_body: Number of bodies before.
        first_shape: Number of shapes before.
        model: MuJoCo's model of the file.
    """
    for body, there in bodies_of_file(builder, first_body, model).items():
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == there]
        solid = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
        if any(model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH for g in geoms if g not in solid):
            continue
        shapes = [s for s in builder.body_shapes[body] if s >= first_shape and builder.shape_flags[s] & _COLLIDE]
        if len(shapes) != len(solid):  # by classes the importer has taken other geoms for colliders
            continue
        for shape, geom in zip(shapes, solid, strict=True):
            if model.geom_group[geom] < _DRAWN_GROUPS and model.geom_rgba[geom, 3] > 0.0:
                builder.shape_flags[shape] = int(builder.shape_flags[shape]) | _VISIBLE
