# SPDX-License-Identifier: Apache-2.0
"""Contacts of the last physics step, in MuJoCo Warp's arrays."""

from __future__ import annotations

import newton
import numpy as np

from stripe_newton.solvers import SolverFused

__all__ = ["contact_count", "touching_geoms", "watch_contacts"]


def watch_contacts(solver: newton.solvers.SolverMuJoCo) -> None:
    """Have the contacts of the following steps written where they can be read."""
    if isinstance(solver, SolverFused):
        solver.fill_contacts()


def touching_geoms(solver: newton.solvers.SolverMuJoCo) -> tuple[np.ndarray, np.ndarray]:
    """Worlds and geoms of all contacts, shapes ``(n,)`` and ``(n, 2)``; after :func:`watch_contacts` and a step."""
    data = solver.mjw_data
    count = int(data.nacon.numpy()[0])
    worlds, geoms = data.contact.worldid.numpy()[:count], data.contact.geom.numpy()[:count]
    there = geoms[:, 0] >= 0  # places without a contact have none
    return worlds[there], geoms[there]


def contact_count(solver: newton.solvers.SolverMuJoCo) -> int:
    """Number of contacts; after :func:`watch_contacts` and a step."""
    return len(touching_geoms(solver)[0])
