# SPDX-License-Identifier: Apache-2.0
"""Fused solver: MuJoCo's physics with the whole step of a world in one kernel, as a Newton solver."""

from __future__ import annotations

from typing import Any

import mujoco
import newton
import warp as wp

from .fused_kernel import FusedKernel, KernelOptions, fused_kernel
from .model_tables import PARAMETERS, ModelTables
from .support import why_unsupported

__all__ = ["SolverFused"]

_WARP = 32
_STATE = ("qpos", "qvel", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")


class SolverFused(newton.solvers.SolverMuJoCo):
    """MuJoCo's physics, of which a whole time step is one kernel.

    MuJoCo compiles the model and MuJoCo Warp holds it, as in :class:`newton.solvers.SolverMuJoCo`. Their arrays are
    read in every step, so that changes take effect as there. Arguments are those of that class.

    The state is the same to rounding. MuJoCo Warp's arrays of contacts, constraint rows and other results are not
    filled, so that sensors and observables that read them need :class:`newton.solvers.SolverMuJoCo`.

    Attributes:
        fused: The kernel of the step.
    """

    def __init__(self, model: newton.Model, **kwargs: Any):
        """Compile the model.

        Raises:
            ValueError: with the reason, if the fused step does not support the model.
        """
        super().__init__(model, **kwargs)
        reason = why_unsupported(self.mj_model)
        if reason:
            raise ValueError(f"the fused solver does not support this model: {reason}; use SolverMuJoCo")
        lanes = _WARP if model.device.is_cuda else 1
        opt: mujoco.MjOption = self.mj_model.opt
        options = KernelOptions(
            lanes=lanes,
            tolerance=float(self.mjw_model.opt.tolerance.numpy()[0]),
            iterations=opt.iterations,
            ls_iterations=opt.ls_iterations,
        )
        rows = int(self.mjw_data.njmax)
        contacts = max(1, int(self.mjw_data.naconmax) // int(self.mjw_data.nworld))
        self._tables = ModelTables.of(self.mj_model, rows, contacts)
        self.fused: FusedKernel = fused_kernel(self._tables, options)
        self._workspace: wp.array | None = None
        if lanes > 1 and not self.fused.in_shared:
            size = self._tables.world_bytes(4) * self.mjw_data.nworld
            self._workspace = wp.empty(size, dtype=wp.uint8, device=model.device)

    def _arguments(self) -> object:
        """Addresses of the arrays, as they are now: notifications of Newton may have replaced some."""
        m = self.fused.arguments()
        for name in _STATE:
            _refer(m, name, getattr(self.mjw_data, name))
        for name, field in PARAMETERS.items():
            owner, _, leaf = f"model.{field}".rpartition(".")
            _refer(m, name, getattr(self.mjw_model.opt if owner.endswith("opt") else self.mjw_model, leaf))
        m.nefc = self.mjw_data.nefc.ptr
        m.solver_niter = self.mjw_data.solver_niter.ptr
        m.workspace = self._workspace.ptr if self._workspace is not None else 0
        return m

    def _mujoco_warp_step(self) -> None:
        self.fused.launch(self._arguments(), self.mjw_data.nworld, str(self.model.device))


def _refer(arguments: Any, name: str, array: wp.array) -> None:
    """Set address and stride of an array whose first dimension is the world, in numbers of four bytes."""
    setattr(arguments, name, array.ptr or 0)
    setattr(arguments, f"{name}_stride", 0 if array.shape[0] == 1 else array.strides[0] // 4)
