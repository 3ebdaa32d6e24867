# SPDX-License-Identifier: Apache-2.0
"""Contacts with height fields, found by their triangles rather than by MuJoCo Warp's general convex routine."""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import numpy as np
import warp as wp

__all__ = ["use_triangles"]


def use_triangles(model: Any) -> int:
    """Take the pairs of a height field and a sphere, capsule or box from MuJoCo Warp's collision detection.

    Their contacts are found by ``stripe_kernels.mujoco_ground`` instead, after MuJoCo Warp's own. All other pairs stay
    as they are, such as those of height fields with meshes, cylinders and ellipsoids.

    Args:
        model: ``mujoco_warp.Model``, before anything is captured.

    Returns:
        Pairs that were taken; 0 where there is no height field, or too many geoms for an explicit list of pairs.
    """
    from mujoco_warp._src.math import upper_trid_index
    from mujoco_warp._src.types import BroadphaseType, GeomType

    taken_kinds = (int(GeomType.SPHERE), int(GeomType.CAPSULE), int(GeomType.BOX))
    kinds = model.geom_type.numpy()
    if not (kinds == int(GeomType.HFIELD)).any():
        return 0
    if model.opt.broadphase != BroadphaseType.NXN:
        warnings.warn(
            f"{len(kinds)} geoms are too many for MuJoCo Warp to list their pairs: contacts with height fields are "
            "found by its general routine, which is slower and feels inner edges; use fewer colliders an environment",
            stacklevel=2,
        )
        return 0
    pairs, ids = model.nxn_geom_pair_filtered.numpy(), model.nxn_pairid_filtered.numpy()
    first_is_field = kinds[pairs[:, 0]] == int(GeomType.HFIELD)
    ordered = np.where(first_is_field[:, None], pairs, pairs[:, ::-1])
    field, other = kinds[ordered[:, 0]], kinds[ordered[:, 1]]
    take = (field == int(GeomType.HFIELD)) & np.isin(other, taken_kinds) & (ids == -1).all(axis=1)
    if not take.any():
        return 0
    counts = list(model.geom_pair_type_count)
    for kind in other[take]:
        counts[upper_trid_index(len(GeomType), int(GeomType.HFIELD), int(kind))] -= 1
    model.geom_pair_type_count = tuple(counts)  # without pairs of a kind its kernels are neither compiled nor launched
    device = model.geom_type.device
    model.nxn_geom_pair_filtered = wp.array(pairs[~take], dtype=wp.vec2i, device=device)
    model.nxn_pairid_filtered = wp.array(ids[~take], dtype=wp.vec2i, device=device)
    ours = ordered[take][np.argsort(other[take], kind="stable")]  # neighbouring threads take the same way
    ours = wp.array(ours, dtype=wp.vec2i, device=device)
    model.callback.contactfilter = partial(_add, ours)
    return int(take.sum())


def _add(pairs: wp.array, model: Any, data: Any) -> None:
    """Launch the kernel; MuJoCo Warp calls this when its own collision detection is done."""
    from stripe_kernels.mujoco_ground import CONTACT_FIELDS, MODEL_FIELDS, add_ground_contacts

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
