# SPDX-License-Identifier: Apache-2.0
"""Drive limits: effort limits of MuJoCo's drives, set where its implicit integration takes them into account."""

from __future__ import annotations

import newton
import numpy as np
import warp as wp

from stripe_kernels.mujoco_model import copy_limits

from .physics_hook import PhysicsHook

__all__ = ["DriveLimits"]


class DriveLimits(PhysicsHook):
    """Limits the force of each drive to the effort of its joint, beside the joint's own limit that Newton sets.

    It is the same torque, but MuJoCo leaves the gains of a drive at its limit out of its implicit integration only
    where the limit is the drive's (``forcerange``): otherwise ``dt`` times the damping goes on adding to the inertia,
    and a saturated joint is slow.

    A joint with a drive for positions and one for velocities keeps its own limit alone, as the limit is one for the sum
    of both. A limit that a file gives a drive stays.
    """

    def __init__(self, solver: newton.solvers.SolverMuJoCo):
        """Find the drives of a solver and limit them."""
        cpu, model = solver.mj_model, solver.mjw_model
        self._model, self._drives, self._joints = model, None, None
        if model is None or solver.mjc_actuator_ctrl_source is None:
            return
        # Drives come from the targets of Newton's joints, source 0; the other actuators have controls of their own.
        joints, is_drive = cpu.actuator_trnid[:, 0], solver.mjc_actuator_ctrl_source.numpy() == 0
        drives_of_joint = np.bincount(joints[is_drive], minlength=cpu.njnt)
        drives = [
            drive
            for drive, joint in enumerate(joints)
            if is_drive[drive]
            and drives_of_joint[joint] == 1
            and cpu.jnt_actfrclimited[joint]
            and not cpu.actuator_forcelimited[drive]
        ]
        if not drives:
            return
        limited = model.actuator_forcelimited.numpy()
        limited[drives] = True
        model.actuator_forcelimited.assign(limited)
        device = model.actuator_forcerange.device
        self._drives = wp.array(drives, dtype=int, device=device)
        self._joints = wp.array(joints[drives], dtype=int, device=device)
        self.launch()

    def launch(self) -> None:
        """Bring the limits up to date with those of the joints; may be captured."""
        if self._drives is not None:
            model = self._model
            inputs = [self._drives, self._joints, model.jnt_actfrcrange]
            dim = len(model.actuator_forcerange), len(self._drives)
            wp.launch(copy_limits, dim=dim, inputs=inputs, outputs=[model.actuator_forcerange])

    def launch_after_notify(self) -> None:
        self.launch()
