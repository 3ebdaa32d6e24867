# SPDX-License-Identifier: Apache-2.0
"""Finite state: a check after the physics steps that positions and velocities are numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from stripe_kernels.actuation import note_not_finite

from .host_flags import HostFlags
from .physics_hook import PhysicsHook

if TYPE_CHECKING:
    from .simulation import Simulation

__all__ = ["FiniteState"]


class FiniteState(PhysicsHook):
    """Reports a state that is not finite, once, by the first joint that has one.

    Environments catch such worlds themselves and reset them; a scene without an environment has nobody to do so.
    """

    def __init__(self, sim: Simulation):
        self._sim = sim
        with wp.ScopedDevice(sim.device):
            self._seen = wp.zeros(1, dtype=wp.int32)
        self._reported = HostFlags(1, sim.device)

    @property
    def follows_each_step(self) -> bool:
        return False  # what is not finite stays so

    def launch_after_step(self) -> None:
        state = self._sim.state
        for values in (state.joint_q, state.joint_qd):
            wp.launch(note_not_finite, dim=len(values), inputs=[values], outputs=[self._seen, self._reported.array])

    def check(self) -> None:
        """Raise if a state was not finite, as of the last report from the device.

        Raises:
            FloatingPointError: naming the environment and the joint.
        """
        if not self._reported[0]:
            return
        self._reported[0] = 0
        self._seen.zero_()
        raise FloatingPointError(self._text())

    def _text(self) -> str:
        sim = self._sim
        advice = "try a smaller time step, or look for extreme masses, gains and velocities in the stage"
        for name, array, starts in (
            ("position", sim.state.joint_q, sim.template.joint_q_start),
            ("velocity", sim.state.joint_qd, sim.template.joint_qd_start),
        ):
            wrong = np.argwhere(~np.isfinite(sim.per_env(array).cpu().numpy()))
            if len(wrong):
                env, index = (int(i) for i in wrong[0])
                joint = int(np.searchsorted(starts, index, side="right")) - 1
                body = sim.template.body_label[sim.template.joint_child[joint]]
                what = f"the {name} of joint '{sim.template.joint_label[joint]}' (body '{body}')"
                return f"environment {env}: {what} is not finite after a physics step; {advice}"
        return f"a position or velocity was not finite after a physics step; {advice}"
