# SPDX-License-Identifier: Apache-2.0
"""Connect anchors: the points that MuJoCo's ``connect`` constraints hold together, as the loop joints have them."""

from __future__ import annotations

import newton
import numpy as np
import warp as wp

from .physics_hook import PhysicsHook

__all__ = ["ConnectAnchors"]


class ConnectAnchors(PhysicsHook):
    """Gives each ``connect`` constraint the anchor of its loop joint on the second body.

    A file gives the anchor on the first body, and Newton's solver takes the one on the second from the pose of joint
    coordinates 0. That pose need not close the loop: of a robot whose coordinates count from elsewhere (MJCF ``ref``)
    it does not. The loop joint has both anchors, from the pose in the file.

    Attributes:
        corrected: Number of constraints of a world whose anchor differed.
    """

    def __init__(self, solver: newton.solvers.SolverMuJoCo):
        """Find the constraints whose anchors differ, and correct them."""
        self._solver, self._relative, self.corrected = solver, None, 0
        if not solver.has_connect_constraints or solver.connect_constraint_X_rel is None:
            return
        model = solver.model
        rows = solver.mjc_eq_to_newton_eq.numpy()
        kinds, anchors = model.mujoco.equality_constraint_type.numpy(), model.mujoco.equality_constraint_anchor.numpy()
        joints, seconds = (
            model.mujoco.equality_constraint_target.numpy(),
            model.mujoco.equality_constraint_body2.numpy(),
        )
        parents, children = model.joint_X_p.numpy(), model.joint_X_c.numpy()
        relative, differ = solver.connect_constraint_X_rel.numpy(), np.zeros(rows.shape, dtype=bool)
        for place in np.argwhere(rows >= 0):
            row, at = rows[tuple(place)], tuple(place)
            if kinds[row] != newton.solvers.SolverMuJoCo.EqType.CONNECT or joints[row] < 0:
                continue
            # Without a second body that is the world, where Newton's joint begins and MuJoCo's constraint ends.
            second = (children if seconds[row] >= 0 else parents)[joints[row]][:3]
            pose = wp.transform(*relative[at])
            if not np.allclose(wp.transform_point(pose, wp.vec3(*anchors[row])), second, atol=1e-6):
                differ[at] = True
                relative[at] = (*(second - anchors[row]), 0.0, 0.0, 0.0, 1.0)
        if differ.any():
            self.corrected = int(differ[0].sum())
            self._relative = wp.array(relative, dtype=wp.transform, device=model.device)
            self.launch_after_notify()

    def launch_after_notify(self) -> None:
        if self._relative is not None:
            wp.copy(self._solver.connect_constraint_X_rel, self._relative)
            # Newton writes the anchors of both bodies from these poses.
            self._solver._notify_connect_constraints_changed(False, True)
