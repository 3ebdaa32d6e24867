# SPDX-License-Identifier: Apache-2.0
"""Growing buffers: a step that overflowed the buffers of MuJoCo Warp is done again with larger ones."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import newton
import numpy as np
import warp as wp

from stripe_newton.solvers import SolverFused

if TYPE_CHECKING:
    from stripe_kernels.actuators import JointDrives

    from .simulation_parts import SimulationParts

__all__ = ["MOST_GROWTH", "SOLVER_STATE", "GrowingBuffers", "enlarge_buffers", "larger_sizes"]

MOST_GROWTH = 256
"""Largest growth of a buffer over its first size; beyond it the scene itself is to be looked at."""
_MODEL_STATE = ("joint_q", "joint_qd")
SOLVER_STATE = ("qpos", "qvel", "act", "qacc_warmstart", "time", "history")
"""Arrays of MuJoCo Warp's data that a step reads and writes."""
_DRIVE_STATE = ("integral", "made_effort", "pushes", "history")
"""Arrays of explicit actuators that a step reads and writes, where the solver's kernel computes them."""


class GrowingBuffers:
    """Runs the solver's part of a step until its contacts and constraints fit.

    Only what the solver itself reads and writes is set back between two tries: actuators, sensors and hooks that run
    around it have run once. On the CPU alone, as a recorded graph has the addresses of the buffers.
    """

    def __init__(self, sim: SimulationParts):
        """Prepare for the solver of a simulation, see :meth:`why_not`."""
        self._sim = sim
        solver = sim.solver
        assert isinstance(solver, newton.solvers.SolverMuJoCo)
        self._solver = solver
        self._most = MOST_GROWTH * max(1, solver.mjw_data.njmax), MOST_GROWTH * max(1, solver.mjw_data.naconmax)
        self._saved: dict[str, wp.array] = {}

    @classmethod
    def of(cls, sim: SimulationParts) -> GrowingBuffers | None:
        """Buffers that grow, or None where they keep their sizes and an overflow is reported.

        They keep them on a GPU; with contacts that others read from arrays of a given size, as Newton's collision
        detection and ``contact_forces`` do; with bodies that sleep; and with solvers that report no overflow.
        """
        solver, reported = sim.solver, sim.reported("overflow")
        if sim.cfg.on_overflow != "grow" or sim.device != "cpu" or reported is None or sim.contacts is not None:
            return None
        grows = isinstance(solver, newton.solvers.SolverMuJoCo) and not solver.use_mujoco_cpu
        return cls(sim) if grows and not solver.enable_sleeping else None

    def run(self, launch: Callable[[], None], drives: JointDrives | None = None) -> None:
        """Launch the solver's step, and again from the same state with larger buffers as long as something is dropped.

        Args:
            launch: Launches the step.
            drives: Explicit actuators that the step computes, too.

        Warns:
            UserWarning: what has grown, from which size to which.
        """
        arrays = dict(self._arrays(drives))
        for name, array in arrays.items():
            if name not in self._saved or self._saved[name].shape != array.shape:
                self._saved[name] = wp.empty_like(array)
            wp.copy(self._saved[name], array)
        launch()
        first = self._sizes
        while self._grow():
            for name, array in arrays.items():
                wp.copy(array, self._saved[name])
            launch()
        if self._sizes != first:
            self._warn_of_growth(first)

    def _arrays(self, drives: JointDrives | None) -> Iterator[tuple[str, wp.array]]:
        """Arrays that the step reads and writes, by name."""
        owners = {"state": (self._sim.state, _MODEL_STATE), "solver": (self._solver.mjw_data, SOLVER_STATE)}
        if drives is not None:
            owners["drives"] = (drives, _DRIVE_STATE)
        for owner, (place, names) in owners.items():
            for name in names:
                array = getattr(place, name)
                if array is not None and array.size:
                    yield f"{owner}.{name}", array

    @property
    def _sizes(self) -> tuple[int, int]:
        """Capacities: constraints of a world, and contacts of all worlds."""
        return self._solver.mjw_data.njmax, self._solver.mjw_data.naconmax

    def _grow(self) -> bool:
        """Double what the last step has overflowed; False if nothing has, or that cannot grow."""
        reported = self._sim.reported("overflow")
        assert reported is not None
        njmax, naconmax = larger_sizes(int(np.bitwise_or.reduce(reported.numpy())), *self._sizes)
        if (njmax, naconmax) == self._sizes:
            return False
        if njmax > self._most[0] or naconmax > self._most[1]:
            return False
        enlarge_buffers(self._solver, njmax, naconmax)
        self._sim.recapture()
        return True

    def _warn_of_growth(self, first: tuple[int, int]) -> None:
        worlds = self._solver.mjw_data.nworld
        sizes = {"njmax": (first[0], self._sizes[0]), "nconmax": (first[1] // worlds, self._sizes[1] // worlds)}
        grown = {name: both for name, both in sizes.items() if both[0] != both[1]}
        what = ", ".join(f"{name} from {old} to {new}" for name, (old, new) in grown.items())
        fields = ", ".join(f"{name}={new}" for name, (_, new) in grown.items())
        message = f"the solver's buffers overflowed and grew, {what}, and the step was done again"
        warnings.warn(f"{message}; MuJoCoSolverCfg({fields}) begins with that", stacklevel=2)


def larger_sizes(bits: int, njmax: int, contacts: int) -> tuple[int, int]:
    """Sizes for constraints and contacts, doubled where they were too small; unchanged where that does not help.

    Args:
        bits: Or of ``mujoco_warp.OverflowType`` and ``SolverMuJoCo.OverflowBits``.
        njmax: Capacity for constraints.
        contacts: Capacity for contacts.
    """
    from mujoco_warp import OverflowType  # other solvers run without it, and it takes a while to load

    own = newton.solvers.SolverMuJoCo.OverflowBits
    of_contacts = OverflowType.BROADPHASE | OverflowType.NARROWPHASE | OverflowType.HFIELD
    of_contacts |= own.SOLVER_NCONMAX | own.CONTACT_PIPELINE
    if bits & of_contacts:
        return 2 * njmax, 2 * contacts  # contacts that were dropped would have had rows, too
    return (2 if bits & (OverflowType.NEFC | OverflowType.NJMAX_NNZ) else 1) * njmax, contacts


def enlarge_buffers(solver: newton.solvers.SolverMuJoCo, njmax: int, naconmax: int) -> None:
    """Replace the arrays of MuJoCo Warp's data whose sizes depend on those of the buffers; the others stay.

    Args:
        solver: The solver, whose contacts are MuJoCo's.
        njmax: Constraints of a world.
        naconmax: Contacts of all worlds.
    """
    import mujoco_warp

    data = solver.mjw_data
    nonzeros = min(njmax * solver.mj_model.nv, -(-data.njmax_nnz * njmax // max(1, data.njmax)))
    sizes = {"njmax": njmax, "njmax_nnz": nonzeros, "naconmax": naconmax, "naccdmax": naconmax}
    # MuJoCo's bindings show arrays that were never allocated, whose numbers may be too large for single precision.
    with wp.ScopedDevice(solver.model.device), np.errstate(over="ignore"):
        larger = mujoco_warp.make_data(solver.mj_model, nworld=data.nworld, nvmax=data.nvmax, **sizes)
    for mine, theirs in ((data, larger), (data.contact, larger.contact), (data.efc, larger.efc)):
        _take_resized(mine, theirs)
    for name in (*sizes, "njmax_pad"):
        setattr(data, name, getattr(larger, name))
    if isinstance(solver, SolverFused):
        solver.notify_buffers_enlarged()


def _take_resized(mine: Any, theirs: Any) -> None:
    """Take over arrays that have another shape."""
    for field in dataclasses.fields(mine):
        old, new = getattr(mine, field.name), getattr(theirs, field.name)
        if isinstance(old, wp.array) and isinstance(new, wp.array) and old.shape != new.shape:
            setattr(mine, field.name, new)
