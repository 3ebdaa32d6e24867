# SPDX-License-Identifier: Apache-2.0
"""Many degrees of freedom: scenes that MuJoCo's solver is slow for, or too large for, and what takes them instead."""

from __future__ import annotations

import os
import warnings

import newton

__all__ = ["check_dof_count"]

_SLOW = 3000
"""Degrees of freedom of an environment from which on a step takes seconds on a CPU."""
_BYTES = 24
"""Memory of MuJoCo Warp's matrices for each pair of degrees of freedom, by measurement [bytes]."""
_INSTEAD = "SimulationCfg(solver=XPBDSolverCfg()) is made for many bodies; or make those static that need not move"


def check_dof_count(model: newton.Model) -> None:
    """Warn of a model that MuJoCo's solver is slow for: its matrices grow with the square of the degrees of freedom.

    Args:
        model: The model.

    Raises:
        ValueError: the matrices are larger than the memory of the device.
    """
    worlds = max(1, model.world_count)
    dofs = model.joint_dof_count // worlds
    if dofs <= _SLOW:
        return
    needed, device = _BYTES * dofs**2 * worlds, model.device
    there = device.total_memory if device.is_cuda else os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    what = f"an environment has {dofs:,} degrees of freedom, for which MuJoCo's matrices take {needed / 1e9:.1f} GB"
    if needed > there:
        raise ValueError(f"{what}, and the device has {there / 1e9:.1f} GB; {_INSTEAD}")
    warnings.warn(f"{what}, and steps take long; {_INSTEAD}", stacklevel=2)
