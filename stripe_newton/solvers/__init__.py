# SPDX-License-Identifier: Apache-2.0
"""Solvers: the physics of articulated robots in one kernel, with MuJoCo's model and MuJoCo's formulas."""

from .solver_fused import SolverFused
from .support import why_unsupported

__all__ = ["SolverFused", "why_unsupported"]
