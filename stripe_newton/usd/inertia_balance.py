# SPDX-License-Identifier: Apache-2.0
"""Inertia balance: inertias that no body can have are corrected as Newton corrects them, and said."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import newton
import numpy as np
import warp as wp

from .text_table import vector

__all__ = ["balance_inertias"]

_FLOAT32_EPS = float(np.finfo(np.float32).eps)


def balance_inertias(builder: newton.ModelBuilder, first: int) -> Iterator[tuple[str, str, str]]:
    """Correct the inertias of the bodies from ``first`` on whose principal moments break the triangle inequality.

    Newton does so by itself when the model is made, without the names of the bodies.

    Yields:
        A row ``(path, what, why)`` for each corrected body.
    """
    for body in range(first, builder.body_count):
        inertia = np.array(builder.body_inertia[body], dtype=float).reshape(3, 3)
        mass = builder.body_mass[body]
        if not mass > 0.0 or not np.isfinite(inertia).all():
            continue
        moments = np.linalg.eigvalsh((inertia + inertia.T) / 2)
        if moments[0] <= 0.0 or moments[0] + moments[1] >= moments[2] * (1.0 - _FLOAT32_EPS):
            continue
        corrected = _by_newton(mass, inertia)
        after = np.linalg.eigvalsh(corrected)
        if np.allclose(after, moments, rtol=1e-5):
            continue
        builder.body_inertia[body] = wp.mat33(*corrected.reshape(-1).tolist())
        builder.body_inv_inertia[body] = wp.inverse(builder.body_inertia[body])
        why = f"{vector(moments.tolist())} kg m^2 is of no body, as two must not add up to less than the third"
        yield builder.body_label[body], "inertia", f"{why}: {vector(after.tolist())} is used"


def _by_newton(mass: float, inertia: np.ndarray) -> np.ndarray:
    """What Newton makes of an inertia when it makes a model."""
    builder = newton.ModelBuilder()
    builder.add_body(mass=mass, inertia=wp.mat33(*inertia.reshape(-1).tolist()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its warning names no body, the row does
        return np.array(builder.finalize(device="cpu").body_inertia.numpy()[0], dtype=float)
