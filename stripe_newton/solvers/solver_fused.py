# SPDX-License-Identifier: Apache-2.0
"""Fused solver: MuJoCo's physics with the whole step of a world in one kernel, as a Newton solver."""

from __future__ import annotations

from typing import Any

import mujoco
import newton
import warp as wp

from .model_tables import PARAMETERS, ModelTables
from .step_kernel import OUTPUTS, STATE, KernelOptions, StepKernel, step_kernel
from .support import why_unsupported

__all__ = ["SolverFused"]

_WARP = 32
_NOT_HERE = {"use_mujoco_cpu": True, "use_mujoco_contacts": False, "use_speculative_contacts": True}
"""Arguments of SolverMuJoCo with the values that lead around the fused step, or that it would ignore."""


class SolverFused(newton.solvers.SolverMuJoCo):
    """MuJoCo's physics, of which a whole time step is one kernel.

    MuJoCo compiles the model and MuJoCo Warp holds it, as in :class:`newton.solvers.SolverMuJoCo`. Their arrays are
    read in every step, so that changes take effect as there. Arguments are those of that class.

    The state is the same to rounding. MuJoCo Warp's arrays of contacts, constraint rows and other results are not
    filled: sensors and observables that read them need :class:`newton.solvers.SolverMuJoCo`. What is constant in the
    kernel stays as it was when the solver was made: topology, what is limited, options, and which equalities act.

    Attributes:
        fused: The kernel of the step.
    """

    def __init__(self, model: newton.Model, **kwargs: Any):
        """Compile the model.

        Raises:
            ValueError: with the reason, if the fused step does not support the model.
        """
        for name, value in _NOT_HERE.items():
            if kwargs.get(name, not value) == value:
                raise ValueError(f"the fused solver does not support {name}={value}; use SolverMuJoCo")
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
        self.fused: StepKernel = step_kernel(self._tables, options)
        self._workspace: wp.array | None = None
        if lanes > 1 and not self.fused.in_shared:
            size = self._tables.world_bytes(4) * self.mjw_data.nworld
            self._workspace = wp.empty(size, dtype=wp.uint8, device=model.device)

    @property
    def supported_observables(self) -> frozenset[str]:
        """Observables that the step fills: overflow, and the forces of actuators."""
        kinds = self.ObservableKind
        return frozenset(super().supported_observables & {kinds.OVERFLOW, kinds.QFRC_ACTUATOR})

    def _enable_rne_postconstraint(self, state_out: newton.State, observables: Any = None) -> None:
        """Refuse fields of the state that the step does not fill.

        Raises:
            ValueError: if the state has one.
        """
        for name in ("body_qdd", "body_parent_f"):
            if getattr(state_out, name) is not None:
                raise ValueError(f"the fused solver does not compute '{name}' of the state; use SolverMuJoCo")

    def _arguments(self) -> object:
        """Addresses of the arrays, as they are now: notifications of Newton may have replaced some."""
        m = self.fused.arguments()
        for name in STATE:
            _refer(m, name, getattr(self.mjw_data, name))
        for name, field in PARAMETERS.items():
            owner, _, leaf = f"model.{field}".rpartition(".")
            _refer(m, name, getattr(self.mjw_model.opt if owner.endswith("opt") else self.mjw_model, leaf))
        for name in OUTPUTS:
            setattr(m, name, getattr(self.mjw_data, name).ptr or 0)
        m.workspace = self._workspace.ptr if self._workspace is not None else 0
        return m

    def _mujoco_warp_step(self) -> None:
        self.fused.launch(self._arguments(), self.mjw_data.nworld, str(self.model.device))


def _refer(arguments: Any, name: str, array: wp.array) -> None:
    """Set address and stride of an array whose first dimension is the world, in numbers of four bytes."""
    setattr(arguments, name, array.ptr or 0)
    setattr(arguments, f"{name}_stride", 0 if array.shape[0] == 1 else array.strides[0] // 4)
