# SPDX-License-Identifier: Apache-2.0
"""Step launcher: owns the kernel of the fused step of a model, and launches it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import mujoco_warp
import newton
import numpy as np
import warp as wp

from .hulls import HullTables
from .kernel_buffers import KernelBuffers
from .kernel_choice import KernelChoice
from .launch_arguments import LaunchArguments, StepCall
from .model_assumptions import ModelAssumptions
from .newton_layout import NewtonLayout
from .pair_division import PairDivision
from .step_kernel import StepKernel, step_kernel

if TYPE_CHECKING:
    from .solver_fused import SolverFused

__all__ = ["StepLauncher"]


class StepLauncher:
    """The kernel of a solver's step, made at its first use and again when it has to do more, and its launches.

    Attributes:
        assumptions: What launches take for given about the model.
        per_step: Names of what any call had to do in each physics step, see :attr:`.per_step.PerStep.kinds`.
    """

    def __init__(self, solver: SolverFused, model: newton.Model):
        """Make no kernel yet.

        Args:
            solver: The solver, which need not be constructed yet.
            model: Its model.
        """
        self._solver = solver
        self.assumptions = ModelAssumptions(solver, model)
        self.per_step: frozenset[str] = frozenset()
        self._division: PairDivision | None = None
        self._kernel: StepKernel | None = None
        self._arguments: LaunchArguments | None = None

    # -- the kernel

    @property
    def kernel(self) -> StepKernel:
        """The kernel, made if there is none."""
        if self._kernel is None:
            choice = self.choice
            tables = choice.tables()
            options = choice.options(tables.limbs)
            kernel = step_kernel(tables, options)
            self.assumptions.find()
            per_world = kernel.layout.workspace_size if options.lanes > 1 else 0
            self.buffers.allocate(self._solver.mjw_data.nworld * per_world, options.given_contacts)
            self._kernel = kernel
        return self._kernel

    @property
    def has_kernel(self) -> bool:
        """Whether the kernel has been made."""
        return self._kernel is not None

    @property
    def choice(self) -> KernelChoice:
        """The choice of form and options for the next kernel."""
        return KernelChoice(
            self._solver, self.division, self.buffers, self.newton_layout, self.per_step, self._solver.limbs
        )

    def remake(self) -> None:
        """Make another kernel for the next launch, as it has to do more."""
        self._kernel = self._arguments = None

    @property
    def division(self) -> PairDivision:
        """Which pairs of geoms the kernel finds contacts of; taken from MuJoCo Warp's list at the first use."""
        if self._division is None:
            self._division = PairDivision.of(self._solver)
        return self._division

    def check_static_meshes(self) -> None:
        """Raise an error if static meshes have changed since the kernel was given their triangles."""
        if self._division is not None and self._division.statics is not None:
            self._division.statics.check_unchanged(self._solver.model)

    @cached_property
    def newton_layout(self) -> NewtonLayout | None:
        """Where Newton's arrays have the state, if the kernel can convert it; None if kernels of Newton must."""
        bodies = self._solver.mjc_body_to_newton.numpy()
        has_all = np.array_equal(np.sort(bodies[bodies >= 0]), np.arange(self._solver.model.body_count))
        return NewtonLayout.of(self._solver) if has_all else None

    @cached_property
    def buffers(self) -> KernelBuffers:
        """Device memory of the kernel."""
        return KernelBuffers(self._solver.mjw_data, self._solver.model.device)

    @cached_property
    def _hulls(self) -> HullTables:
        return HullTables(self._solver.mj_model, self.division.pairs, self._solver.model.device)

    # -- launches

    def launch(self, call: StepCall) -> None:
        """Advance all worlds, in one launch if the kernel finds all contacts itself.

        Args:
            call: What is to be done.
        """
        kernel, data, device = self.kernel, self._solver.mjw_data, str(self._solver.model.device)
        drives = call.per_step.solver_drives or call.per_step.drives
        state = call.state
        if state is not None and state.state_in is not state.state_out:
            for name in ("joint_q", "joint_qd"):  # the kernel leaves joints of kinematic bodies as they are
                wp.copy(getattr(state.state_out, name), getattr(state.state_in, name))
        if not kernel.options.given_contacts:
            kernel.launch(self.arguments(call), data.nworld, device, call.steps, drives=drives)
            return
        for index in range(call.steps):
            arguments = self.arguments(call, first=index == 0, last=index == call.steps - 1)
            if self._solver.uses_mujoco_contacts:
                kernel.launch(arguments, data.nworld, device, place=True)
                mujoco_warp.collision(self._solver.mjw_model, data)
            self.buffers.sort_given_contacts()
            kernel.launch(arguments, data.nworld, device, drives=drives)

    def arguments(self, call: StepCall, first: bool = True, last: bool = True) -> object:
        """Return the arguments of a launch, see :meth:`.launch_arguments.LaunchArguments.of`."""
        kernel = self.kernel
        if self._arguments is None:
            statics = self.division.statics
            self._arguments = LaunchArguments(
                self._solver, kernel, self.buffers, self.assumptions, self._hulls, statics
            )
        return self._arguments.of(call, first, last)

    def clear_arguments(self) -> None:
        """Look all addresses up again at the next launch: arrays may have been replaced."""
        if self._arguments is not None:
            self._arguments.clear()
