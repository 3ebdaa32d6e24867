# SPDX-License-Identifier: Apache-2.0
"""Contact probe: contact forces of the present state, by a physics step whose result is thrown away."""

from __future__ import annotations

from typing import TYPE_CHECKING

import newton
import warp as wp

from .observables import wanted_observables

if TYPE_CHECKING:
    from .simulation import Simulation

__all__ = ["ContactProbe"]


class ContactProbe:
    """Computes contact forces where a simulation does not export them in every step.

    State and warm start stay as they are. Efforts of explicit actuators are those of the last step.

    Attributes:
        contacts: The contacts, after :meth:`run`.
        observables: The forces, after :meth:`run`.
    """

    def __init__(self, sim: Simulation):
        """Allocate memory.

        Raises:
            ValueError: if the solver does not report forces.
        """
        self._sim = sim
        wanted_observables(sim.solver, (), contact_forces=True)  # which says what does not report them
        with wp.ScopedDevice(sim.device):
            self._after = sim.model.state()
            self.contacts = sim.contacts
            if self.contacts is None:
                self.contacts = newton.Contacts(sim.solver.get_max_contact_count(), 0, device=sim.device)
            self.observables = sim.solver.observables({"contact_f"}, contacts=self.contacts)

    def run(self) -> None:
        """Find the contacts of the present state and compute their forces."""
        sim = self._sim
        data = getattr(sim.solver, "mjw_data", None)  # MuJoCo Warp's, which other solvers do not have
        before = None if data is None else wp.clone(data.qacc_warmstart)
        with wp.ScopedDevice(sim.device), sim.actuation.solver_gains():
            if sim.pipeline is not None:
                sim.pipeline.collide(sim.state, self.contacts)
            sim.solver.step(
                sim.state, self._after, sim.control, self.contacts, sim.physics_dt, observables=self.observables
            )
            if data is not None:
                wp.copy(data.qacc_warmstart, before)
