# SPDX-License-Identifier: Apache-2.0
"""Solver overflow: contacts and constraints that did not fit into the solver's buffers."""

from __future__ import annotations

import newton
import warp as wp

from stripe_kernels.actuation import note_overflow
from stripe_newton.solvers import SolverFused

from .host_flags import HostFlags
from .physics_hook import PhysicsHook

__all__ = ["SolverOverflow", "overflow_message"]


class SolverOverflow(PhysicsHook):
    """Collects the overflow bits that MuJoCo Warp reports for each world and each step.

    MuJoCo Warp drops what does not fit and goes on. Its own warning is a print for every world in every step, so it is
    switched off, and the bits are read here instead.

    Attributes:
        seen: Bits that are known already and not reported again, int32, shape ``(1,)``.
    """

    def __init__(self, solver: newton.solvers.SolverMuJoCo, observables: newton.solvers.SolverBase.Observables):
        """Read the ``overflow`` of ``observables``, on the current device, after every physics step."""
        self._solver, self._observables = solver, observables
        self.seen = wp.zeros(1, dtype=wp.int32)
        self._unread = HostFlags(1, str(self.seen.device))
        if isinstance(solver, SolverFused) and self.seen.device.is_cuda:  # on the CPU a step may be done again
            solver.collect_overflow(self.seen, self._unread.array)
        solver.mjw_model.opt.warn_overflow = 0

    @property
    def follows_each_step(self) -> bool:
        return False  # the bits of steps that are launched together are collected

    def launch_after_step(self) -> None:
        if isinstance(self._solver, SolverFused) and self._solver.collects_overflow(self._observables):
            return
        bits = self._observables.overflow
        wp.launch(note_overflow, dim=len(bits), inputs=[bits], outputs=[self.seen, self._unread.array])

    def report_overflow(self) -> str:
        bits = self._unread[0]
        if not bits:
            return ""
        self._unread[0] = 0
        self.seen.zero_()
        return overflow_message(bits, self._solver)


def overflow_message(bits: int, solver: newton.solvers.SolverMuJoCo) -> str:
    """The buffers that overflowed and what to set instead; empty for bits that mean no loss (iteration limits).

    Args:
        bits: Or of ``mujoco_warp.OverflowType`` and ``SolverMuJoCo.OverflowBits``.
        solver: The MuJoCo solver.
    """
    import mujoco_warp  # other solvers run without it, and it takes a while to load

    kinds, own = mujoco_warp.OverflowType, newton.solvers.SolverMuJoCo.OverflowBits
    data = solver.mjw_data
    nconmax = max(1, data.naconmax // data.nworld)  # MuJoCo Warp has one buffer for the contacts of all worlds
    lost = []
    if bits & kinds.NEFC:
        lost.append(f"constraints: njmax is {data.njmax}, set MuJoCoSolverCfg(njmax={2 * data.njmax})")
    if bits & kinds.NJMAX_NNZ:
        lost.append("constraint Jacobian: set a larger MuJoCoSolverCfg(njmax_nnz=...)")
    if bits & (kinds.BROADPHASE | kinds.NARROWPHASE | kinds.HFIELD | own.SOLVER_NCONMAX):
        lost.append(f"contacts: nconmax is {nconmax}, set MuJoCoSolverCfg(nconmax={2 * nconmax})")
    if bits & kinds.NVMAX:
        lost.append("awake degrees of freedom: set a larger MuJoCoSolverCfg(nvmax=...)")
    if bits & own.CONTACT_PIPELINE:
        lost.append("contacts of Newton's collision pipeline: its buffer is too small for this scene")
    return "the solver's buffers overflowed and dropped " + "; ".join(lost) if lost else ""
