# SPDX-License-Identifier: Apache-2.0
"""MJCF sites: ``connect`` and ``weld`` between two sites bring the sites together, wherever they are at the start."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import newton
import numpy as np
import warp as wp
from newton.solvers import SolverMuJoCo

__all__ = ["tie_sites", "tied_rows"]


def tie_sites(
    builder: newton.ModelBuilder,
    first: int,
    model: mujoco.MjModel,
    scale: float = 1.0,
    xform: wp.transform | None = None,
) -> None:
    """Let constraints between sites hold the sites, for which Newton takes the second body as it is at the start.

    The two are the same where the sites are in one place at the start, as in most files.

    Args:
        builder: The builder, with the file.
        first: Number of MuJoCo's equality constraints before the file was added.
        model: MuJoCo's model of the file.
        scale: Scale of lengths.
        xform: Pose of the file's world frame; None: the identity.
    """
    for row, equality in _rows(builder, first, model):
        if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            _tie(builder, row, model, equality, scale, wp.transform_identity() if xform is None else xform)


def tied_rows(builder: newton.ModelBuilder, first: int, model: mujoco.MjModel) -> Iterator[tuple[tuple[int, int], int]]:
    """Both bodies of the builder, -1 for the world, and MuJoCo's number of each ``connect`` and ``weld``."""
    for row, equality in _rows(builder, first, model):
        yield (_column(builder, "body1")[row], _column(builder, "body2")[row]), equality


def _rows(builder: newton.ModelBuilder, first: int, model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Row of the builder and MuJoCo's number of each ``connect`` and ``weld``."""
    kinds = _column(builder, "type")
    for theirs, ours in (
        (mujoco.mjtEq.mjEQ_CONNECT, SolverMuJoCo.EqType.CONNECT),
        (mujoco.mjtEq.mjEQ_WELD, SolverMuJoCo.EqType.WELD),
    ):
        rows = [row for row in range(first, len(kinds)) if kinds[row] == ours]
        equalities = np.flatnonzero(model.eq_type == theirs).tolist()
        if len(rows) == len(equalities):  # otherwise the report has a row for those that are missing
            yield from zip(rows, equalities, strict=True)


def _tie(
    builder: newton.ModelBuilder, row: int, model: mujoco.MjModel, equality: int, scale: float, xform: wp.transform
) -> None:
    bodies = [_column(builder, f"body{number}")[row] for number in (1, 2)]
    sites = [_frame(model, int(site), scale) for site in (model.eq_obj1id[equality], model.eq_obj2id[equality])]
    # A site of the world is held in the builder's world, where the file's may stand elsewhere.
    sites = [site if body >= 0 else xform * site for body, site in zip(bodies, sites, strict=True)]
    one, two = (
        site if body < 0 else wp.transform(*builder.body_q[body]) * site
        for body, site in zip(bodies, sites, strict=True)
    )
    welded = model.eq_type[equality] == mujoco.mjtEq.mjEQ_WELD
    joint = _column(builder, "target")[row]
    if np.allclose(list(one.p), list(two.p), atol=1e-6) and (not welded or abs(np.dot(one.q, two.q)) > 1.0 - 1e-9):
        return
    # A point of the first body that ``connect`` holds, and of the second that ``weld`` turns about.
    _column(builder, "anchor")[row] = sites[int(welded)].p
    # Newton's loop joint goes from the first body to the second, and from the world where one of them is the world.
    parent, child = sites if bodies[1] >= 0 else sites[::-1]
    if welded:
        _column(builder, "relpose")[row] = wp.transform(sites[0].p, sites[0].q * wp.quat_inverse(sites[1].q))
        builder.joint_X_p[joint], builder.joint_X_c[joint] = parent, child
        return
    frames = builder.joint_X_p, builder.joint_X_c
    for frame, site in zip(frames, (parent, child), strict=True):
        frame[joint] = wp.transform(site.p, wp.transform(*frame[joint]).q)


def _frame(model: mujoco.MjModel, site: int, scale: float) -> wp.transform:
    """Pose of a site in its body."""
    w, x, y, z = (float(v) for v in model.site_quat[site])
    return wp.transform(wp.vec3(*(float(v) * scale for v in model.site_pos[site])), wp.quat(x, y, z, w))


def _column(builder: newton.ModelBuilder, name: str) -> list[Any]:
    attribute = builder.custom_attributes.get(f"mujoco:equality_constraint_{name}")
    return attribute.values if attribute is not None and isinstance(attribute.values, list) else []
