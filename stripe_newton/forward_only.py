# SPDX-License-Identifier: Apache-2.0
"""Forward-only kernels: compiles the kernels of Newton and MuJoCo Warp without their gradients, in a third of the time.

Warp compiles a kernel together with its adjoint, from which gradients are computed. A reinforcement learning
environment asks for none. What is left out of a module takes no time to compile, and the rest of it is the same.
"""

from __future__ import annotations

import os
import sys

import warp as wp

__all__ = ["GRADIENTS", "leave_out_gradients"]

GRADIENTS = "STRIPE_NEWTON_GRADIENTS"
"""Environment variable: 1 keeps the gradients, for programs that compute some through Newton's kernels."""
_LIBRARIES = ("newton._src.", "mujoco_warp.", "stripe_kernels.")
_WITH_GRADIENTS = ("newton._src.sim.ik", "newton._src.actuators", "newton._src.controllers")
"""Packages that compute gradients themselves: inverse kinematics and actuators that are networks."""


def leave_out_gradients() -> None:
    """Let the kernels of the libraries that are imported by now be compiled without gradients.

    Kernels that are in use stay as they are. Call it again after importing further modules; that takes a millisecond.
    """
    if os.environ.get(GRADIENTS, "0") not in ("", "0"):
        return
    for name, module in list(sys.modules.items()):
        if name.startswith(_LIBRARIES) and not name.startswith(_WITH_GRADIENTS):
            for value in list(vars(module).values()):
                # A kernel that is imported from elsewhere belongs to the package that defines it.
                if isinstance(value, wp.Kernel) and value.func.__module__ == name:
                    _leave_out(value.module)


def _leave_out(module: wp.Module) -> None:
    if module.options["enable_backward"] and not module.execs:
        module.options["enable_backward"] = False
        module.mark_modified()  # else a hash that was computed before would name the files
