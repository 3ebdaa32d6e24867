# SPDX-License-Identifier: Apache-2.0
"""Inertia balance: inertias that no body can have are corrected as Newton corrects them, and said."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import newton
import numpy as np
import warp as wp

from .text_table import vector

__all__ = ["SMALLEST_INERTIA", "balance_inertias"]

_LEAST_MARGIN, _MARGIN = 1e-6, 3e-6
"""Share of the largest moment by which the other two must exceed it, and by which they do where they do not."""

SMALLEST_INERTIA = 1.0e-15
"""Least moment of inertia that is kept [kg m^2], MuJoCo's ``mjMINVAL``: Newton would raise what is below 1e-10, such as
a marker of a milligram, to 1e-6."""


def balance_inertias(builder: newton.ModelBuilder, first: int) -> Iterator[tuple[str, str, str]]:
    """Correct the inertias of the bodies from ``first`` on that are those of no body.

    Newton does so by itself when the model is made, without the names of the bodies: whose principal moments break the
    triangle inequality, or are not positive. An inertia at the limit, as of a thin plate or of a corrected body, is
    raised by a few millionths without a row: otherwise rounding would decide whether MuJoCo accepts it.

    Yields:
        A row ``(path, what, why)`` for each corrected body.
    """
    builder.inertia_absolute_tolerance = SMALLEST_INERTIA
    inertias = np.array(builder.body_inertia[first:], dtype=float).reshape(-1, 3, 3)
    masses = np.array(builder.body_mass[first:], dtype=float)
    sound = np.flatnonzero((masses > 0.0) & np.isfinite(inertias).all(axis=(1, 2)))
    if not len(sound):
        return
    corrected = _by_newton(builder, masses[sound], inertias[sound])
    for k, after in zip(sound, corrected, strict=True):
        before, body = (inertias[k] + inertias[k].T) / 2, first + int(k)
        if not np.isfinite(after).all():
            continue
        if np.allclose(after, before, rtol=1e-5, atol=1e-5 * np.abs(before).max()):
            if (lift := _lift_off_the_limit(before)) > 0.0:
                _set_inertia(builder, body, before + lift * np.eye(3))
            continue
        after = after + _lift_off_the_limit(after) * np.eye(3)
        _set_inertia(builder, body, after)
        moments = np.linalg.eigvalsh(before)
        reason = "they must be positive" if moments[0] <= 0.0 else "two must not add up to less than the third"
        why = f"{vector(moments.tolist())} kg m^2 is of no body, as {reason}"
        used = vector(np.linalg.eigvalsh(after).tolist())
        yield builder.body_label[body], "inertia", f"{why}: {used} is used"


def _lift_off_the_limit(inertia: np.ndarray) -> float:
    """Amount to add to the moments of an inertia so that rounding keeps the triangle inequality [kg m^2]."""
    low, middle, high = np.linalg.eigvalsh(inertia)
    margin = low + middle - high
    return float(_MARGIN * high - margin) if margin < _LEAST_MARGIN * high else 0.0


def _set_inertia(builder: newton.ModelBuilder, body: int, inertia: np.ndarray) -> None:
    builder.body_inertia[body] = wp.mat33(*inertia.reshape(-1).tolist())
    builder.body_inv_inertia[body] = wp.mat33(*np.linalg.inv(inertia).reshape(-1).tolist())


def _by_newton(builder: newton.ModelBuilder, masses: np.ndarray, inertias: np.ndarray) -> np.ndarray:
    """Inertias as Newton corrects them when it makes a model, shape ``(bodies, 3, 3)``."""
    bodies = newton.ModelBuilder()
    bodies.inertia_absolute_tolerance = builder.inertia_absolute_tolerance
    for mass, inertia in zip(masses, inertias, strict=True):
        bodies.add_body(mass=float(mass), inertia=wp.mat33(*inertia.reshape(-1).tolist()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its warning names no body, the row does
        return np.array(bodies.finalize(device="cpu").body_inertia.numpy(), dtype=float).reshape(-1, 3, 3)
