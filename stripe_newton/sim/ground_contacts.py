# SPDX-License-Identifier: Apache-2.0
"""Ground contacts: contacts with height fields from their triangles, in place of MuJoCo Warp's convex routine."""

from __future__ import annotations

import warnings
from functools import partial

import mujoco_warp
import numpy as np
import warp as wp
from mujoco_warp._src.types import BroadphaseType, GeomType

from stripe_kernels.mujoco_ground import CONTACT_FIELDS, MODEL_FIELDS, add_ground_contacts
from stripe_newton.solvers.pair_list import remove_geom_pairs

__all__ = ["use_triangles"]

_FIELD = int(GeomType.HFIELD)
_TOUCHING = int(GeomType.SPHERE), int(GeomType.CAPSULE), int(GeomType.BOX)
"""Geoms whose contacts with triangles ``stripe_kernels.mujoco_ground`` finds."""


def use_triangles(model: mujoco_warp.Model) -> int:
    """Take the pairs of a height field and a sphere, capsule or box from MuJoCo Warp's collision detection.

    Their contacts are found by ``stripe_kernels.mujoco_ground`` instead, after MuJoCo Warp's own. All other pairs stay
    as they are, such as those of height fields with meshes, cylinders and ellipsoids.

    Args:
        model: The model, before anything is captured.

    Returns:
        Pairs that were taken; 0 where there is no height field, or too many geoms for an explicit list of pairs.
    """
    kinds = model.geom_type.numpy()
    if not (kinds == _FIELD).any():
        return 0
    if model.opt.broadphase != BroadphaseType.NXN:
        # Above some number of geoms MuJoCo Warp sorts them along an axis, and there is no list to take pairs from.
        warnings.warn(
            f"{len(kinds)} geoms are too many for MuJoCo Warp to list their pairs: contacts with height fields are "
            "found by its general routine, which is slower and feels inner edges; use fewer colliders an environment",
            stacklevel=2,
        )
        return 0
    pairs, ids = model.nxn_geom_pair_filtered.numpy(), model.nxn_pairid_filtered.numpy()
    first_is_field = kinds[pairs[:, 0]] == _FIELD
    ordered = np.where(first_is_field[:, None], pairs, pairs[:, ::-1])
    field, other = kinds[ordered[:, 0]], kinds[ordered[:, 1]]
    # A pair with an id has contact parameters of its own in the file, which the general routine reads.
    take = (field == _FIELD) & np.isin(other, _TOUCHING) & (ids == -1).all(axis=1)
    if not take.any():
        return 0
    remove_geom_pairs(model, take)
    # Sorted by kind, so that neighbouring threads take the same branch.
    taken = ordered[take][np.argsort(other[take], kind="stable")]
    model.callback.contactfilter = partial(_add, wp.array(taken, dtype=wp.vec2i, device=model.geom_type.device))
    return int(take.sum())


def _add(pairs: wp.array, model: mujoco_warp.Model, data: mujoco_warp.Data) -> None:
    """Launch the kernel; MuJoCo Warp calls this when its own collision detection is done."""
    wp.launch(
        add_ground_contacts,
        dim=(len(pairs), data.nworld),
        inputs=[
            pairs,
            data.geom_xpos,
            data.geom_xmat,
            data.naconmax,
            *(getattr(model, name) for name in MODEL_FIELDS),
        ],
        outputs=[*(getattr(data.contact, name) for name in CONTACT_FIELDS), data.nacon],
        device=data.geom_xpos.device,
        block_dim=64,  # few, so that the shapes that are on the ground are spread over all multiprocessors
    )
