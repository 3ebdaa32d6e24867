# SPDX-License-Identifier: Apache-2.0
"""Wrench form: models whose constraint rows have no Jacobians in the fused step, and the sizes of that form."""

from __future__ import annotations

import mujoco
import numpy as np

from .topology import tree_roots

__all__ = ["ROW_SIZE", "STIFFNESS_SIZE", "has_wrench_rows"]

ROW_SIZE = 13
"""Numbers of a row, as in world.h."""
STIFFNESS_SIZE = 36
"""Numbers of the stiffness of a group of contacts, as in wrench_rows.h."""
_DOFS = 33, 40
"""Least and most degrees of freedom of such models.

With more of them than a warp has lanes, rows of Jacobians are so long that those of a robot on two feet do not fit into
the shared memory. Beyond 40 too many rows of the matrix would share a lane with another.
"""
_ONE_TREE = 2
"""Trees of a model that has one beside the world."""


def has_wrench_rows(model: mujoco.MjModel) -> bool:
    """Whether the constraint rows of a model are kept as wrenches, see wrench_rows.h."""
    is_one_tree = len(tree_roots(model)) == _ONE_TREE and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    has_others = model.neq or np.any(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL)
    return bool(is_one_tree and not has_others and _DOFS[0] <= model.nv <= _DOFS[1])
