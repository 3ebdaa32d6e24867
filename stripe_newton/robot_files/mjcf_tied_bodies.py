# SPDX-License-Identifier: Apache-2.0
"""MJCF tied bodies: bodies that ``connect`` or ``weld`` ties collide in MuJoCo, unless the file excludes it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import mujoco
import newton
import numpy as np

from .mjcf_sites import tied_rows
from .urdf_checks import Row

__all__ = ["let_tied_bodies_collide"]


def let_tied_bodies_collide(builder: newton.ModelBuilder, first: int, model: mujoco.MjModel) -> Iterator[Row]:
    """Take back that Newton lets tied bodies pass through each other, as those of a joint.

    Args:
        builder: The builder, with the file.
        first: Number of MuJoCo's equality constraints before the file was added.
        model: MuJoCo's model of the file.

    Yields:
        A row for each constraint of which some shapes may collide and others not: those bodies stay as they are.
    """
    for bodies, equality in tied_rows(builder, first, model):
        theirs = _bodies(model, equality)
        if min(bodies) < 0 or _is_filtered(model, *theirs):
            continue
        matches = _matches(model, *theirs)
        if matches and not all(matches):
            name = model.equality(equality).name or f"equality {equality}"
            yield name, "collisions", "not between the bodies that it ties: MuJoCo would let some of their shapes"
        elif matches:
            shapes = (builder.body_shapes.get(body, []) for body in bodies)
            pairs = {(min(pair), max(pair)) for pair in product(*shapes)}
            kept = [pair for pair in builder.shape_collision_filter_pairs if (min(pair), max(pair)) not in pairs]
            builder.shape_collision_filter_pairs[:] = kept


def _bodies(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    one, two = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        return int(model.site_bodyid[one]), int(model.site_bodyid[two])
    return one, two


def _is_filtered(model: mujoco.MjModel, one: int, two: int) -> bool:
    """Whether MuJoCo leaves out contacts of two bodies: welded, parent and child, or excluded by the file."""
    welds = [int(model.body_weldid[body]) for body in (one, two)]
    above = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
    related = 0 not in welds and (above[0] == welds[1] or above[1] == welds[0])
    signatures = {(one << 16) + two, (two << 16) + one}
    return welds[0] == welds[1] or related or not signatures.isdisjoint(model.exclude_signature.tolist())


def _matches(model: mujoco.MjModel, one: int, two: int) -> list[bool]:
    """Whether MuJoCo lets each pair of colliding geoms of two bodies collide."""
    geoms = [np.flatnonzero((model.geom_bodyid == body) & _collides(model)) for body in (one, two)]
    return [
        bool(model.geom_contype[a] & model.geom_conaffinity[b] or model.geom_contype[b] & model.geom_conaffinity[a])
        for a, b in product(*geoms)
    ]


def _collides(model: mujoco.MjModel) -> np.ndarray:
    return (model.geom_contype != 0) | (model.geom_conaffinity != 0)
