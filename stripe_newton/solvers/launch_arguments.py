# SPDX-License-Identifier: Apache-2.0
"""Launch arguments: the struct of addresses that a launch of the fused step's kernel takes, and where they come from.

Most addresses hold until the model or the kernel changes: they are filled in once (:meth:`LaunchArguments._constant`).
Those of Newton's state and controls come with each call of the solver's ``step`` (:meth:`LaunchArguments.of`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import newton
import warp as wp

from .hulls import HullTables
from .kernel_buffers import KernelBuffers
from .model_assumptions import ModelAssumptions
from .per_step import PerStep
from .shared_parameters import parameter_arrays
from .static_triangles import StaticTriangles
from .step_kernel import CONTACTS, NEWTON_IN, NEWTON_MODEL, NEWTON_OUT, OUTPUTS, READ, STATE, StepKernel

__all__ = ["ConvertedState", "LaunchArguments", "StepCall", "efforts_field"]

_EFFORTS = newton.solvers.SolverMuJoCo.ObservableKind.QFRC_ACTUATOR


@dataclass
class ConvertedState:
    """Newton's state and controls in a call of ``step`` of which the kernel reads and writes them itself."""

    state_in: newton.State
    state_out: newton.State
    control: newton.Control | None
    observables: Any
    reads_state: bool = False
    """Whether the state comes from Newton's, rather than from where the last step has left it in MuJoCo's."""
    writes_bodies: bool = True
    """Whether poses and velocities of bodies are written."""

    @property
    def efforts(self) -> wp.array | None:
        """Array for the forces of actuators, if anybody reads them."""
        if self.observables is not None and self.observables.is_requested(_EFFORTS):
            return self.observables.qfrc_actuator
        return efforts_field(self.state_out)

    def inputs(self, first: bool) -> dict[str, wp.array]:
        """Arrays of ``NEWTON_IN`` that the state and controls have; the joints are read in the first launch alone."""
        arrays = {"body_f": self.state_in.body_f}
        if self.reads_state and first:
            arrays |= {"joint_q_in": self.state_in.joint_q, "joint_qd_in": self.state_in.joint_qd}
        control = self.control
        if control is not None and control.joint_f is not None:
            arrays |= {name: getattr(control, name) for name in ("joint_f", "joint_target_q", "joint_target_qd")}
            arrays["controls"] = getattr(getattr(control, "mujoco", None), "ctrl", None)
        return arrays

    def outputs(self) -> dict[str, wp.array]:
        """Arrays of ``NEWTON_OUT`` that the state has."""
        state = self.state_out
        arrays = {"joint_q_out": state.joint_q, "joint_qd_out": state.joint_qd, "efforts": self.efforts}
        return arrays | ({"body_q": state.body_q, "body_qd": state.body_qd} if self.writes_bodies else {})


@dataclass
class StepCall:
    """Arguments of a call of ``step_many``; the defaults are those of ``step``."""

    steps: int = 1
    before: tuple[wp.array | None, wp.array] | None = None
    """Positions and velocities of the joints before the last step, to be written."""
    per_step: PerStep = field(default_factory=PerStep)
    state: ConvertedState | None = None
    """Newton's state, if the kernel converts it; None if kernels of Newton do so around it."""
    dt: float = 0.0
    """Time step [s]; 0 for that of MuJoCo Warp's model."""
    body_outputs: dict[str, wp.array] = field(default_factory=dict)
    """Arrays for accelerations and wrenches of bodies, by their names in ``NEWTON_OUT``."""
    overflow: wp.array | None = None
    """Array for overflow bits, ``(num_worlds,)``; None for that of MuJoCo Warp's data."""


class LaunchArguments:
    """Fills in the arguments of one kernel."""

    def __init__(
        self,
        solver: newton.solvers.SolverMuJoCo,
        kernel: StepKernel,
        buffers: KernelBuffers,
        assumptions: ModelAssumptions,
        hulls: HullTables,
        statics: StaticTriangles | None,
    ):
        """Fill in nothing yet.

        Args:
            solver: The solver, which has the arrays of MuJoCo Warp and the model.
            kernel: The kernel.
            buffers: Memory of the kernel.
            assumptions: Tells which parameters all worlds share.
            hulls: Convex hulls of meshes whose contacts the kernel finds.
            statics: Static meshes whose triangles the kernel looks at.
        """
        self._solver, self._kernel, self._buffers, self._assumptions = solver, kernel, buffers, assumptions
        self._hulls, self._statics = hulls, statics
        self._filled: dict[bool, Any] = {}

    def clear(self) -> None:
        """Look all addresses up again at the next launch: arrays may have been replaced."""
        self._filled.clear()

    def of(self, call: StepCall, first: bool, last: bool) -> object:
        """Return the arguments of a launch.

        Args:
            call: The call that the launch belongs to.
            first: Whether it is the first launch of the call.
            last: Whether it is the last one, which writes results.

        Returns:
            A struct, which the next call fills in anew.
        """
        if last not in self._filled:
            self._filled[last] = self._constant(last)
        m = self._filled[last]
        inputs = self._inputs(call, first)
        outputs = self._outputs(call) if last else {}
        for name in NEWTON_IN:
            setattr(m, name, _address(inputs.get(name)))
        for name in NEWTON_OUT:
            setattr(m, name, _address(outputs.get(name)))
        _set_rows(m, "overflow", self._solver.mjw_data.overflow if call.overflow is None else call.overflow)
        m.overflow_seen, m.overflow_told = map(_address, self._buffers.overflow_bits or (None, None))
        m.dt = call.dt
        return m

    def _inputs(self, call: StepCall, first: bool) -> dict[str, wp.array]:
        """Arrays of ``NEWTON_IN`` that a launch reads: none where kernels of Newton convert its state."""
        if call.state is None:
            return {}
        work = call.per_step
        arrays = {"velocity_limit": work.velocity_limit, "external_wrench": work.external_wrench}
        return call.state.inputs(first) | arrays | {"wrench_in_world": work.wrench_in_world}

    def _outputs(self, call: StepCall) -> dict[str, wp.array]:
        """Arrays of ``NEWTON_OUT`` that a last launch writes."""
        arrays = call.body_outputs | ({} if call.state is None else call.state.outputs())
        if call.per_step.solver_drives is not None:
            arrays["computed_effort"] = call.per_step.solver_drives.computed_effort
        if call.before is not None:
            arrays |= dict(zip(("joint_q_before", "joint_qd_before"), call.before, strict=True))
        return arrays

    def _constant(self, last: bool) -> object:
        """A struct with the addresses that are the same in all launches."""
        m, solver, buffers = self._kernel.arguments(), self._solver, self._buffers
        data = solver.mjw_data
        for name in (*STATE, *OUTPUTS):
            _set_rows(m, name, getattr(data, name))
        for name, array in parameter_arrays(solver).items():
            _set_rows(m, name, array, shared=name in self._assumptions.shared.names)
        m.eq_active = _address(data.eq_active)
        m.field_size, m.field_heights = map(_address, (solver.mjw_model.hfield_size, solver.mjw_model.hfield_data))
        statics = self._statics
        m.meshes = 0 if statics is None or statics.grids is None else _address(statics.grids.array)
        m.hidden = 0 if statics is None else _address(statics.hidden_geoms)
        m.hulls = _address(self._hulls.array)
        m.workspace = _address(buffers.workspace)
        own = {"newton_body": solver.mjc_body_to_newton, "dof_ref": self._assumptions.references}
        own |= dict(zip(("joint_X_p", "joint_X_c"), self._assumptions.anchors, strict=True))
        for name in NEWTON_MODEL:
            setattr(m, name, _address(own[name] if name in own else getattr(solver.model, name)))
        if buffers.bodies is not None:
            _set_rows(m, "bodies", buffers.bodies)
        if buffers.given is not None:
            _set_rows(m, "contacts", buffers.given.rows)
            m.contact_count = _address(buffers.given.count)
        if last:
            self._set_contact_results(m)
        return m

    def _set_contact_results(self, m: Any) -> None:
        """Set the addresses of what the last launch of a call writes of contacts."""
        data, buffers = self._solver.mjw_data, self._buffers
        if buffers.contact_forces is not None:
            _set_rows(m, "force_geoms", buffers.contact_forces.geoms)
            _set_rows(m, "contact_forces", buffers.contact_forces.forces)
        if buffers.fills_contacts:
            for name in CONTACTS:
                setattr(m, f"contact_{name}", _address(getattr(data.contact, name)))
            for name in READ:
                _set_rows(m, name, data.efc.force if name == "efc_force" else getattr(data, name))


def efforts_field(state: newton.State) -> wp.array | None:
    """The field of a state for the forces of actuators, which Newton's observables replace."""
    return getattr(getattr(state, "mujoco", None), "qfrc_actuator", None)


def _address(array: wp.array | None) -> int:
    return 0 if array is None else array.ptr or 0


def _set_rows(arguments: Any, name: str, array: wp.array, shared: bool = False) -> None:
    """Set address and stride of an array whose first dimension is the world, in numbers of four bytes.

    Args:
        arguments: Arguments of the kernel.
        name: Name of the array in them.
        array: The array.
        shared: Whether all worlds read the row of the first one.
    """
    setattr(arguments, name, array.ptr or 0)
    setattr(arguments, f"{name}_stride", 0 if shared or array.shape[0] == 1 else array.strides[0] // 4)
