# SPDX-License-Identifier: Apache-2.0
"""Pair list: MuJoCo Warp's list of the pairs of geoms that may collide."""

from __future__ import annotations

import mujoco_warp
import numpy as np
import warp as wp
from mujoco_warp._src.math import upper_trid_index
from mujoco_warp._src.types import GeomType

__all__ = ["remove_geom_pairs"]


def remove_geom_pairs(model: mujoco_warp.Model, remove: np.ndarray) -> None:
    """Take pairs of geoms out of MuJoCo Warp's list of pairs that may collide.

    Args:
        model: The model, before anything is captured, with ``BroadphaseType.NXN``.
        remove: Which pairs of ``nxn_geom_pair_filtered``, bool, shape ``(pairs,)``.
    """
    pairs, ids = model.nxn_geom_pair_filtered.numpy(), model.nxn_pairid_filtered.numpy()
    counts = list(model.geom_pair_type_count)
    for low, high in np.sort(model.geom_type.numpy()[pairs[remove]], axis=1).tolist():
        counts[upper_trid_index(len(GeomType), low, high)] -= 1
    # The list says which pairs may collide, the counts which kinds of pairs there are at all: without pairs of a kind
    # its kernels are neither compiled nor launched. Nothing else in the model counts pairs.
    model.geom_pair_type_count = tuple(counts)
    device = model.geom_type.device
    model.nxn_geom_pair_filtered = wp.array(pairs[~remove], dtype=wp.vec2i, device=device)
    model.nxn_pairid_filtered = wp.array(ids[~remove], dtype=wp.vec2i, device=device)
