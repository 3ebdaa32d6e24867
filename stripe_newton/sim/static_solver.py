# SPDX-License-Identifier: Apache-2.0
"""Static solver: stands in for a solver where nothing moves, as in a kitchen without loose objects."""

from __future__ import annotations

from collections.abc import Sequence

import newton
import warp as wp

__all__ = ["SolverStatic", "complete_state"]


class SolverStatic(newton.solvers.SolverBase):
    """A solver of a model without bodies: its steps leave everything as it is."""

    def __init__(self, model: newton.Model, observables: Sequence[str] = ()):
        super().__init__(model)

    def step(self, *args: object, **kwargs: object) -> None:
        """Do nothing."""

    def notify_model_changed(self, flags: int) -> None:
        """Do nothing: shapes are not copied."""

    def reset(self, *args: object, **kwargs: object) -> None:
        """Do nothing: nothing is remembered."""


def complete_state(state: newton.State) -> None:
    """Give a state without bodies empty arrays, where Newton has none."""
    state.joint_q, state.joint_qd = wp.zeros(0, dtype=float), wp.zeros(0, dtype=float)
    state.body_q, state.body_qd = wp.zeros(0, dtype=wp.transform), wp.zeros(0, dtype=wp.spatial_vector)
