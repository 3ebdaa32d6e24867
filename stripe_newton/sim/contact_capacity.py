# SPDX-License-Identifier: Apache-2.0
"""Contact capacity: contacts and constraint rows that a world of a model may need at once."""

from __future__ import annotations

import newton
import numpy as np
from newton import GeoType, ShapeFlags

__all__ = ["contact_capacity"]

_POINTS = {GeoType.SPHERE: 1, GeoType.ELLIPSOID: 1, GeoType.CAPSULE: 2}
_ON_FIELD = {GeoType.SPHERE: 4, GeoType.ELLIPSOID: 4, GeoType.CAPSULE: 6}
"""Contacts of a shape with one other, and with a height field, where it may lie on several triangles."""
_MOST = 8
"""Contacts of any other shape, such as a box on a box, and of a body as a whole: more do not hold it better."""
_ON_TRIANGLES = {**_ON_FIELD, GeoType.BOX: 12}
"""Contacts of a shape with the triangles of meshes: of a box seven corners, and four with bumps between them."""
_MOST_ON_TRIANGLES = 12
_ROWS = 4
"""Rows of a contact: a pyramid with two tangents."""


def contact_capacity(model: newton.Model, on_triangles: bool = False) -> tuple[int, int]:
    """Contacts and constraint rows of a world in which each body that can move lies on others.

    MuJoCo Warp's own defaults, 48 contacts and 64 rows without a height field, are too few for a hand or a pile.

    Args:
        model: The finalized model.
        on_triangles: Whether bodies may lie on the triangles of static meshes.

    Returns:
        The contacts, and the rows with those of joint limits, friction and equality constraints, of the world that
        needs most.
    """
    types, bodies, worlds = (a.numpy() for a in (model.shape_type, model.shape_body, model.body_world))
    collides = (model.shape_flags.numpy() & ShapeFlags.COLLIDE_SHAPES) != 0
    points = _ON_FIELD if (types[collides] == GeoType.HFIELD).any() else _POINTS
    if on_triangles:
        points = _ON_TRIANGLES
    of_body = np.zeros(model.body_count, dtype=int)
    for shape in np.flatnonzero(collides & (bodies >= 0)):
        of_body[bodies[shape]] += points.get(GeoType(types[shape]), _MOST)
    of_body = np.minimum(of_body, _MOST_ON_TRIANGLES if on_triangles else _MOST)
    contacts = _largest(worlds, of_body, model.world_count)
    others = 2 * model.joint_dof_count + 6 * _equalities(model)
    return contacts, _ROWS * contacts + -(-others // max(1, model.world_count))


def _equalities(model: newton.Model) -> int:
    """Equality constraints of all worlds: MuJoCo's own, joints that follow others, and joints that close loops."""
    own = getattr(getattr(model, "mujoco", None), "equality_constraint_type", None)
    loops = int((model.joint_articulation.numpy() < 0).sum()) if model.joint_count else 0
    return (0 if own is None else len(own)) + model.constraint_mimic_count + loops


def _largest(worlds: np.ndarray, values: np.ndarray, count: int) -> int:
    """The largest sum of a world; what is in no world is in each."""
    sums = np.bincount(worlds[worlds >= 0], values[worlds >= 0], minlength=max(1, count))
    return int(sums.max(initial=0) + values[worlds < 0].sum())
