# SPDX-License-Identifier: Apache-2.0
"""What to say when a solver's buffers were too small."""

from __future__ import annotations

from typing import Any

import newton

__all__ = ["overflow_message"]


def overflow_message(bits: int, solver: Any) -> str:
    """Which buffers overflowed and what to set instead; empty for bits that mean no loss (iteration limits).

    Args:
        bits: Or of ``mujoco_warp.OverflowType`` and ``SolverMuJoCo.OverflowBits``.
        solver: The MuJoCo solver.
    """
    import mujoco_warp

    kinds, own = mujoco_warp.OverflowType, newton.solvers.SolverMuJoCo.OverflowBits
    data = solver.mjw_data
    nconmax = max(1, data.naconmax // data.nworld)
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
