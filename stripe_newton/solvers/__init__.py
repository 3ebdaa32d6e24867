# SPDX-License-Identifier: Apache-2.0
"""Solvers: the physics of articulated robots in one kernel, with MuJoCo's model and MuJoCo's formulas."""

from .kernel_buffers import ContactForces
from .per_step import PerStep
from .solver_fused import SolverFused
from .support import why_unsupported

__all__ = ["ContactForces", "PerStep", "SolverFused", "why_unsupported"]
