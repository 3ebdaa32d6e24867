# SPDX-License-Identifier: Apache-2.0
"""Absent shapes: shapes of the model that some environments do not have."""

from __future__ import annotations

import newton
import numpy as np
import warp as wp
from newton import ShapeFlags

from stripe_kernels.mujoco_model import mark_absent_geoms

from .physics_hook import PhysicsHook

__all__ = ["AbsentShapes"]

_ALL = int(ShapeFlags.COLLIDE_SHAPES) | int(ShapeFlags.COLLIDE_PARTICLES) | int(ShapeFlags.VISIBLE)


class AbsentShapes(PhysicsHook):
    """Keeps shapes from touching, being drawn and being seen in the environments that do not have them.

    Their flags say so to Newton's collision detection, viewers, cameras and rays. MuJoCo Warp's geoms have no flags for
    each world: an absent one has a margin that nothing can be within, which its broad phase and the fused step heed.
    """

    def __init__(self, solver: newton.solvers.SolverBase, shapes: np.ndarray):
        """Clear the flags and set the margins.

        Args:
            solver: The solver, made while the flags of all worlds were alike, as MuJoCo's own contacts need it.
            shapes: The shapes of the model, shape ``(count,)``.
        """
        model = solver.model
        flags = model.shape_flags.numpy().copy()
        flags[shapes] &= ~_ALL
        model.shape_flags.assign(flags)
        self._solver, self._absent = solver, None
        if getattr(solver, "mjw_model", None) is None or not solver._use_mujoco_contacts:
            _leave_out_pairs(model, shapes)
        else:
            shape_of_geom = solver.mjc_geom_to_newton_shape.numpy()
            absent = np.isin(shape_of_geom, shapes) & (shape_of_geom >= 0)
            self._absent = wp.array(absent, dtype=wp.bool, device=model.device)
        self.launch_after_notify()

    def launch_after_notify(self) -> None:
        if self._absent is not None:
            margin = self._solver.mjw_model.geom_margin
            wp.launch(mark_absent_geoms, dim=self._absent.shape, inputs=[self._absent], outputs=[margin])


def _leave_out_pairs(model: newton.Model, shapes: np.ndarray) -> None:
    """Take pairs with some shapes from those that Newton's collision detection goes through."""
    if model.shape_contact_pairs is None:
        return
    pairs = model.shape_contact_pairs.numpy()
    kept = pairs[~np.isin(pairs, shapes).any(axis=1)]
    model.shape_contact_pairs = wp.array(kept, dtype=wp.vec2i, device=model.device)
