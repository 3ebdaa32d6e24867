# SPDX-License-Identifier: Apache-2.0
"""Fused solver: MuJoCo's physics with the whole step of a world in one kernel, as a Newton solver."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mujoco
import mujoco_warp
import newton
import numpy as np
import warp as wp

from stripe_kernels.fused_contacts import FIELDS, GIVEN_SIZE, list_contacts, sort_contacts

from .contact_pairs import MESH_KINDS
from .hulls import HullTables
from .limb_form import LimbForm, why_no_limbs
from .model_tables import PARAMETERS, ModelTables
from .newton_layout import NewtonLayout
from .pair_division import PairDivision
from .per_step import PerStep
from .shared_parameters import SharedParameters, parameters_of_flags, parameters_of_newton
from .stand_ins import StandIns
from .step_kernel import (
    BODY_SIZE,
    CONTACTS,
    NEWTON_IN,
    NEWTON_MODEL,
    NEWTON_OUT,
    OUTPUTS,
    READ,
    STATE,
    KernelOptions,
    StepKernel,
    step_kernel,
)  # fmt: skip
from .support import why_unsupported

__all__ = ["ContactForces", "SolverFused"]

_LANES = 8, 32
"""Threads of a GPU that share a world: of a model that has no more bodies and degrees of freedom, and of others."""
_NOT_HERE = {"use_mujoco_cpu": True, "use_speculative_contacts": True}
"""Arguments of SolverMuJoCo with the values that lead around the fused step, or that it would ignore."""
_OF_BODIES = ("body_qdd", "body_parent_f")
"""Accelerations and wrenches of bodies, which the kernel writes where somebody reads them."""


@dataclass
class ContactForces:
    """Forces of the contacts of the last step. Each world has a row, in which its contacts come first.

    Other arrays take the place of these when the solver's buffers are enlarged.
    """

    geoms: wp.array
    """The two geoms of MuJoCo's model, ``wp.vec2i``, shape ``(num_worlds, places)``; -1 in the first place without a
    contact, behind which nothing is valid."""
    forces: wp.array
    """Forces on the second geom in the world frame [N], ``wp.vec3``, shape ``(num_worlds, places)``."""


@dataclass
class _Call:
    """Arguments of a call of ``step``: the state and controls that it reads, and where it writes."""

    state_in: newton.State
    state_out: newton.State
    control: newton.Control | None
    observables: Any
    reads_state: bool = False
    """Whether the state comes from Newton's, rather than from where the last step has left it in MuJoCo's."""


class SolverFused(newton.solvers.SolverMuJoCo):
    """MuJoCo's physics, of which a whole time step is one kernel.

    MuJoCo compiles the model and MuJoCo Warp holds it, as in :class:`newton.solvers.SolverMuJoCo`. Their arrays are
    read in every step, so that changes take effect as there. Arguments are those of that class.

    The kernel finds the contacts of the pairs that it has a routine for, see ``docs/solvers.md``. If there are others,
    MuJoCo Warp's collision detection finds theirs before each step; otherwise several steps are one launch. With
    ``use_mujoco_contacts=False`` all are those that :meth:`step` is given.

    The state is that of MuJoCo Warp to rounding, and so are ``body_qdd`` and ``body_parent_f``. MuJoCo Warp's arrays of
    contacts and constraint forces are filled after :meth:`fill_contacts`, those of other results are not; forces of
    contacts alone are written after :meth:`fill_contact_forces`, which takes less. What is
    constant in the kernel is as it was at the first step: topology, pairs of geoms, what is limited, and options.

    Attributes:
        unsupported: Reason why MuJoCo Warp steps the model instead; empty if the fused step does.
        triangles: Whether contacts of spheres, capsules, boxes and cylinders with height fields are those with its
            triangles, which the kernel finds; otherwise MuJoCo Warp's. Set it before the first step.
        static_triangles: Whether static colliders that ``model.stripe.triangles`` marks touch spheres, capsules and
            boxes with their triangles; otherwise meshes are their hulls, as MuJoCo has it. Set it before the first
            step, and see :meth:`lacks`.
        stand_ins: Static shapes that are no geoms, see :meth:`finds_hidden`; None for none.
        limbs: Whether a robot that is a hub with limbs, which touch nothing that moves, is stepped in a form for such
            robots, see ``docs/solvers.md``; None where it is faster. Set it before the first step.
        newton_contacts_for: Kinds of pairs because of which contacts are Newton's, to be named in :meth:`describe`.
        has_stale_graphs: Whether graphs that were recorded before must be recorded again, as worlds were found to
            differ in what was the same in all of them, see :meth:`expect_changes`. Who records them sets it to False.
    """

    def __init__(
        self, model: newton.Model, *, fallback: bool = False, stand_ins: StandIns | None = None, **kwargs: Any
    ):
        """Compile the model.

        Args:
            model: The model.
            fallback: Let MuJoCo Warp step a model that is not supported, and say why in :attr:`unsupported`.
            stand_ins: Static shapes that are no geoms, see :meth:`finds_hidden`.
            **kwargs: Arguments of ``SolverMuJoCo``.

        Raises:
            ValueError: with the reason, if the fused step does not support the model and ``fallback`` is False.
        """
        reason = next((f"{n}={v}" for n, v in _NOT_HERE.items() if kwargs.get(n, not v) == v), "")
        if reason and not fallback:
            raise ValueError(f"the fused solver does not support {reason}; use SolverMuJoCo")
        self._addresses: dict[bool, Any] = {}  # these first, as the constructor notifies
        self._shared = SharedParameters(self._parameter_arrays)
        self.has_stale_graphs, self._compares_worlds, self._has_references = False, True, True
        self._has_kinematic_bodies = False
        self._fused: StepKernel | None = None
        self._division: PairDivision | None = None
        self._call: _Call | None = None
        self.stand_ins = stand_ins
        with stand_ins.hide(model) if stand_ins is not None else nullcontext():
            super().__init__(model, **kwargs)
        if stand_ins is not None and not self._use_mujoco_contacts:
            stand_ins.map_shapes(self.newton_shape_to_mjc_geom)
        self.unsupported = reason or self._why_kinematic() or why_unsupported(self.mj_model)
        if self.unsupported and not fallback:
            raise ValueError(f"the fused solver does not support this model: {self.unsupported}; use SolverMuJoCo")
        self.triangles = self.static_triangles = False
        self.limbs: bool | None = None
        self.newton_contacts_for: tuple[str, ...] = ()
        self._workspace: wp.array | None = None
        self._workspaces: list[wp.array] = []  # all that recorded graphs may have the addresses of
        self._fills_contacts = False
        self._contact_forces: ContactForces | None = None
        self._steps = 1
        self._before: tuple[wp.array | None, wp.array] | None = None
        self._dt = self._filled_dt = 0.0
        self._overflow: wp.array | None = None
        self._told: tuple[wp.array, wp.array] | None = None
        self._per_step = PerStep()
        self._kinds: frozenset[str] = frozenset()  # of what any call had to do in each step
        self._accelerations: dict[str, wp.array] = {}
        self._kept_bodies: wp.array | None = None

    def _why_kinematic(self) -> str:
        """Reason not to step kinematic bodies: Newton places the welds that hold them anew before each step."""
        return "a body is kinematic or may become it" if self._kinematic_weld_eq is not None else ""

    # -- what it does

    def lacks(self) -> list[str]:
        """Kinds of pairs of which contacts with triangles are needed and not found, see :func:`mark_triangles`."""
        return self._divided.hulls

    def finds_hidden(self) -> bool:
        """Whether contacts with shapes that are no geoms are found: MuJoCo Warp's collision detection would not."""
        if self.unsupported or self.lacks():
            return False
        return any(pair.kind in MESH_KINDS.values() for pair in self._divided.pairs)

    @property
    def uses_mujoco_contacts(self) -> bool:
        """Whether contacts are MuJoCo's and the kernel's own, rather than those that :meth:`step` is given."""
        return self._use_mujoco_contacts

    @property
    def _divided(self) -> PairDivision:
        """The division of the pairs, made when it is first asked for."""
        if self._division is None:
            self._division = PairDivision.of(self)
        return self._division

    @property
    def hidden_shapes(self) -> np.ndarray:
        """Shapes of the static colliders that are no geoms; contacts have them as geoms from ``ngeom`` on."""
        return self.stand_ins.hidden if self.stand_ins is not None else np.zeros(0, dtype=int)

    @property
    def one_launch(self) -> bool:
        """Whether several steps are one launch, as no collision detection by others has to come between."""
        return not self.unsupported and not self.fused.options.given_contacts

    @property
    def converts(self) -> bool:
        """Whether the kernel reads and writes Newton's state itself, rather than kernels of Newton around it."""
        return not self.unsupported and self._layout is not None

    @property
    def fused(self) -> StepKernel:
        """The kernel of the step, made when it is first asked for."""
        if self._fused is None:
            self._fused = self._make()
        return self._fused

    def describe(self, between: Sequence[str] = ()) -> str:
        """Describe in a line what computes a step, and why.

        Args:
            between: Names of what the caller has to run between physics steps.
        """
        by = "" if self._use_mujoco_contacts else ", with Newton's collision detection for all contacts"
        by += f", because of {', '.join(self.newton_contacts_for)}" if self.newton_contacts_for else ""
        if self.unsupported:
            return f"MuJoCo Warp{by}, as the fused step does not support the model: {self.unsupported}"
        if by:
            return f"the fused step{by}"
        if not self.one_launch:
            return "the fused step, with MuJoCo Warp's collision detection for " + ", ".join(self._divided.others)
        between = [*([] if self.converts else ["Newton's conversion of the state"]), *between]
        limbs = self.fused.layout.num_limbs
        form = f", of a hub with {limbs} limbs" if limbs > 1 else ""
        form += f", not of a hub with limbs ({why})" if (why := self._why_no_limbs()) else ""
        if between:
            return f"the fused step{form}, a launch for each physics step because of " + ", ".join(between)
        return f"the fused step{form}, all physics steps of a step in one launch"

    @property
    def supported_observables(self) -> frozenset[str]:
        """Observables that the step fills."""
        every = super().supported_observables
        if self.unsupported:
            return every
        kinds = self.ObservableKind
        bodies = {kinds.BODY_QDD, kinds.BODY_PARENT_F}
        return frozenset(every & {kinds.OVERFLOW, kinds.QFRC_ACTUATOR, kinds.CONTACT_F, *bodies})

    def observables(self, requested: Any, *args: Any, **kwargs: Any) -> Any:
        """Allocate observables, as :meth:`newton.solvers.SolverMuJoCo.observables`."""
        made = super().observables(requested, *args, **kwargs)
        if not self.unsupported and made.is_requested(self.ObservableKind.CONTACT_F):
            self.fill_contacts()
        if not self.unsupported and any(made.is_requested(name) for name in _OF_BODIES):
            self._compute_accelerations()
        return made

    def fill_contacts(self) -> None:
        """Fill MuJoCo Warp's arrays of contacts and constraint forces from the next step on.

        Each world has its own places in the arrays of contacts, ``naconmax / nworld`` of them; those without a contact
        have geoms and rows of -1. Graphs that were recorded before do not fill them: see :meth:`Simulation.recapture`.
        """
        if self.unsupported or self._fills_contacts:
            return
        if not self._use_mujoco_contacts:  # Newton keeps what it knows of its contacts there, from step to step
            self.unsupported = "contacts of Newton's collision detection are read"
            return
        if len(self.hidden_shapes):
            raise RuntimeError(
                "contacts cannot be written to MuJoCo's arrays, as its model has not all static shapes: ask for "
                "'contact_f' among the observables of the simulation before it is built"
            )
        self._fills_contacts = True
        self._remake()
        self.mjw_data.nacon.fill_(self.mjw_data.naconmax)

    def fill_contact_forces(self) -> ContactForces | None:
        """Write the forces of contacts from the next step on, which takes less than :meth:`fill_contacts`.

        Graphs that were recorded before do not write them.

        Returns:
            Arrays that each step overwrites; None where MuJoCo Warp steps the model, or does so from now on because
            contacts are those of Newton's collision detection.
        """
        if not self._use_mujoco_contacts:
            self.fill_contacts()
        if self.unsupported:
            return None
        if self._contact_forces is None:
            self._contact_forces = ContactForces(*self._contact_places())
            self._remake()
        return self._contact_forces

    def _contact_places(self) -> tuple[wp.array, wp.array]:
        """Arrays of geoms and forces for as many contacts as fit."""
        shape, device = (self.mjw_data.nworld, self.mjw_data.naconmax // self.mjw_data.nworld), self.model.device
        geoms = wp.full(shape, value=wp.vec2i(-1, -1), dtype=wp.vec2i, device=device)
        return geoms, wp.zeros(shape, dtype=wp.vec3, device=device)

    def notify_buffers_enlarged(self) -> None:
        """Take other sizes of MuJoCo Warp's buffers from the next step on, in a kernel that is made for them.

        Graphs that were recorded before must not be replayed: see :meth:`Simulation.recapture`.
        """
        if self.unsupported:
            return
        self._workspace = None
        if self._fills_contacts:
            self.mjw_data.nacon.fill_(self.mjw_data.naconmax)
        if self._contact_forces is not None:
            self._contact_forces.geoms, self._contact_forces.forces = self._contact_places()
        self._remake()

    def _remake(self) -> None:
        """Make another kernel for the next step, as more is asked of it."""
        self._fused = None
        self._addresses.clear()

    def compile_ahead(self, per_step: PerStep) -> None:
        """Begin to compile the kernel of the step, which the first step waits for.

        Args:
            per_step: What :meth:`step_many` is going to be given.
        """
        if not self.unsupported and self.converts:
            self.prepare(per_step)
            self.fused.compile_ahead(str(self.model.device))

    # -- a step

    def step_many(
        self,
        state_in: newton.State,
        state_out: newton.State,
        control: newton.Control,
        dt: float,
        steps: int,
        observables: Any = None,
        before: tuple[wp.array | None, wp.array] | None = None,
        per_step: PerStep | None = None,
    ) -> None:
        """Advance by several time steps with the same controls.

        Args:
            state_in: The state before.
            state_out: The state after; it may be the same object.
            control: Targets and forces, which apply in all steps.
            dt: Time step [s].
            steps: Number of steps.
            observables: Arrays to report, of the last step; overflow is of all.
            before: Output, positions (None for those not) and velocities of the joints before the last step, shapes
                ``(joint_coord_count,)`` and ``(joint_dof_count,)``.
            per_step: Actuators, external wrenches and velocity limits. The first call with one of them makes
                a kernel that has it, so that others lose no registers of a GPU to it.

        Raises:
            RuntimeError: if MuJoCo Warp steps the model, ``before`` or ``per_step`` is given but :attr:`converts` is
                False, or contacts are Newton's, which are those of one step.
        """
        if self.unsupported:
            raise RuntimeError(f"several steps at once need the fused step: {self.unsupported}")
        if steps > 1 and not self._use_mujoco_contacts:
            raise RuntimeError("Newton's collision detection has to run before each step")
        per_step = per_step or PerStep()
        if (before is not None or per_step.kinds) and not self.converts:
            asked = sorted({*per_step.kinds, *(["the joints before the last step"] if before is not None else [])})
            raise RuntimeError(f"{', '.join(asked)}: need a kernel that converts Newton's state, as `converts` says")
        self.prepare(per_step)
        self._steps, self._before, self._per_step = steps, before, per_step
        try:
            contacts = observables.contacts if observables is not None else None
            self.step(state_in, state_out, control, contacts, dt, observables=observables)
        finally:
            self._steps, self._before, self._per_step = 1, None, PerStep()

    def prepare(self, per_step: PerStep) -> None:
        """Take a kernel that has what ``per_step`` asks for, from the next step on."""
        if not per_step.kinds <= self._kinds:
            self._kinds |= per_step.kinds
            self._remake()

    def _enable_rne_postconstraint(self, state_out: newton.State, observables: Any = None) -> None:
        """Note which accelerations and wrenches of bodies the coming step has to write, and where."""
        if self.unsupported:
            super()._enable_rne_postconstraint(state_out, observables)
            return
        self._accelerations = {}
        for name in _OF_BODIES:
            asked = observables is not None and observables.is_requested(name)
            array = getattr(observables if asked else state_out, name)
            if array is not None:
                self._accelerations[name] = array
        if self._accelerations:
            self._compute_accelerations()

    def _compute_accelerations(self) -> None:
        """Take a kernel that can compute accelerations of bodies from now on."""
        if self._kept_bodies is None:
            shape = self.mjw_data.nworld, BODY_SIZE * self.mj_model.nbody
            self._kept_bodies = wp.empty(shape, dtype=float, device=self.model.device)
            self._remake()

    def step(
        self,
        state_in: newton.State,
        state_out: newton.State,
        control: newton.Control | None,
        contacts: newton.Contacts | None,
        dt: float,
        *,
        observables: Any = None,
    ) -> None:
        """Advance by one time step, as :meth:`newton.solvers.SolverMuJoCo.step`."""
        call = self._call = _Call(state_in, state_out, control, observables) if self.converts else None
        try:
            if call is not None and self._does_all(observables):
                self._step_in_kernel(call, contacts, dt)
            else:
                super().step(state_in, state_out, control, contacts, dt, observables=observables)
        finally:
            self._call = None

    def _does_all(self, observables: Any) -> bool:
        """Whether the kernel does all of a step, so that what the base class launches around it is left out."""
        if not self.converts or not self._use_mujoco_contacts or not self.one_launch:
            return False
        return observables is None or not observables.is_requested(self.ObservableKind.CONTACT_F)

    def _step_in_kernel(self, call: _Call, contacts: newton.Contacts | None, dt: float) -> None:
        """Advance as the base class does, but for what the kernel does as well: time step, reports of overflows."""
        self.validate_observables(call.observables, contacts)
        with wp.ScopedDevice(self.model.device):
            self._enable_rne_postconstraint(call.state_out, call.observables)
            call.reads_state = self._update_data_interval > 0 and self._step % self._update_data_interval == 0
            if self._filled_dt != dt:  # others read it there
                self.mjw_model.opt.timestep.fill_(dt)
                self._filled_dt = dt
            is_reported = call.observables is not None and call.observables.is_requested(self.ObservableKind.OVERFLOW)
            self._dt, self._overflow = dt, call.observables.overflow if is_reported else None
            try:
                self._mujoco_warp_step()
            finally:
                self._dt, self._overflow = 0.0, None
            self._update_newton_state(self.model, call.state_out, self.mjw_data, call.state_in, call.observables)
        self._step += 1

    def tell_overflow(self, seen: wp.array, told: wp.array) -> None:
        """Let the kernel collect the overflow bits of all worlds from the next step on, see :meth:`tells_overflow`.

        Args:
            seen: Bits so far, int32, shape ``(1,)``.
            told: The same for the host, in its memory, where new bits are written.
        """
        self._told = seen, told

    def tells_overflow(self, observables: Any) -> bool:
        """Whether the kernel collects all overflow bits of steps with these observables."""
        return self._told is not None and self._does_all(observables)

    # The base class calls the following around a step. Where the kernel does what they do, they do nothing.

    def _apply_mjc_control(self, *args: Any, **kwargs: Any) -> None:
        if self._call is None:
            super()._apply_mjc_control(*args, **kwargs)

    def _update_mjc_data(self, *args: Any, **kwargs: Any) -> None:
        if self._call is None:
            super()._update_mjc_data(*args, **kwargs)
        else:
            self._call.reads_state = True

    def _update_newton_state(
        self, model: newton.Model, state: newton.State, mj_data: Any, state_prev: newton.State, observables: Any = None
    ) -> None:
        if self._call is None:
            super()._update_newton_state(model, state, mj_data, state_prev, observables)
            return
        self._update_body_observables(model, state, mj_data, observables)
        efforts, field = self._efforts(self._call), _field_of_efforts(state)
        if efforts is not None and field is not None and field.ptr != efforts.ptr:
            wp.copy(field, efforts)

    def _efforts(self, call: _Call) -> wp.array | None:
        """Array for the forces of actuators, if anybody reads them."""
        if call.observables is not None and call.observables.is_requested(self.ObservableKind.QFRC_ACTUATOR):
            return call.observables.qfrc_actuator
        return _field_of_efforts(call.state_out)

    def _update_body_observables(
        self, model: newton.Model, state: newton.State, mj_data: Any, observables: Any = None
    ) -> None:
        """Copy what the kernel has written to the state where that has such a field, too."""
        if self.unsupported or mj_data is not self.mjw_data:
            super()._update_body_observables(model, state, mj_data, observables)
            return
        for name, written in self._accelerations.items():
            field = getattr(state, name)
            if field is not None and field.ptr != written.ptr:
                wp.copy(field, written)

    def _mujoco_warp_step(self) -> None:
        if self.unsupported:
            super()._mujoco_warp_step()
            return
        kernel, data, device = self.fused, self.mjw_data, str(self.model.device)
        drives = self._per_step.solver_drives or self._per_step.drives
        if self._call is not None and self._call.state_in is not self._call.state_out:
            for name in ("joint_q", "joint_qd"):  # the kernel leaves joints of kinematic bodies as they are
                wp.copy(getattr(self._call.state_out, name), getattr(self._call.state_in, name))
        if self.one_launch:
            arguments = self._arguments(first=True, last=True)
            kernel.launch(arguments, data.nworld, device, self._steps, drives=drives)
            return
        for index in range(self._steps):
            arguments = self._arguments(first=index == 0, last=index == self._steps - 1)
            if self._use_mujoco_contacts:
                kernel.launch(arguments, data.nworld, device, place=True)
                mujoco_warp.collision(self.mjw_model, data)
            self._list_contacts()
            kernel.launch(arguments, data.nworld, device, drives=drives)

    def _list_contacts(self) -> None:
        """Put in order the contacts that the kernel does not find itself."""
        data, contact = self.mjw_data, self.mjw_data.contact
        self._count.zero_()
        wp.launch(
            list_contacts,
            dim=data.naconmax,
            inputs=[data.nacon, contact.worldid, contact.type, contact.dist, contact.includemargin],
            outputs=[self._count, self._found],
            device=self.model.device,
        )
        fields = [getattr(contact, name) for name in FIELDS]
        inputs = [self._count, self._found, *fields]
        wp.launch(sort_contacts, self._found.shape, inputs, [self._given], device=self.model.device)
        if self._fills_contacts:
            data.nacon.fill_(data.naconmax)

    def expect_changes(self, names: Iterable[str]) -> None:
        """Expect that worlds will differ in arrays of Newton's model, which may change within a recorded graph.

        A parameter that is the same in all worlds is read from the first one. :meth:`notify_model_changed` finds out
        where they differ, but waits for the device for that.

        Args:
            names: Names of attributes of ``newton.Model``.
        """
        names = list(names)
        if self._shared.expect_changes(parameters_of_newton(names)):
            self._addresses.clear()
            self.has_stale_graphs = True
        if "body_flags" in names and not self._has_kinematic_bodies:
            self._has_kinematic_bodies = self.has_stale_graphs = True
            self._remake()

    @contextmanager
    def changes_expected(self) -> Iterator[None]:
        """Context for :meth:`notify_model_changed` of changes that were told: worlds are not compared again."""
        self._compares_worlds = False
        try:
            yield
        finally:
            self._compares_worlds = True

    # -- the kernel and its arguments

    def _make(self) -> StepKernel:
        """Write the kernel, and leave to MuJoCo Warp's collision detection what it has no routine for."""
        data, device = self.mjw_data, self.model.device
        opt: mujoco.MjOption = self.mj_model.opt
        contacts = max(1, int(data.naconmax) // int(data.nworld))
        limbs = self.limbs is not False and not self._asked
        tables = ModelTables.of(
            self._limited_model(),
            int(data.njmax),
            contacts,
            self._divided.pairs,
            limbs=limbs,
            losses=self._has_losses(),
            newton=self._layout,
        )
        if tables.limbs is not None and self.limbs is None and device.is_cuda and not tables.limbs.suits_gpu:
            tables = replace(tables, limbs=None)
        self._find_kinematic_bodies()
        options = KernelOptions(
            lanes=self._lanes(tables.limbs) if device.is_cuda else 1,
            tolerance=float(self.mjw_model.opt.tolerance.numpy()[0]),
            iterations=opt.iterations,
            ls_iterations=opt.ls_iterations,
            given_contacts=bool(self._divided.others),
            accelerations=self._kept_bodies is not None,
            contacts=self._fills_contacts,
            contact_forces=self._contact_forces is not None,
            kinematic_bodies=self._has_kinematic_bodies,
            per_step=self._kinds,
        )
        kernel = step_kernel(tables, options)
        self._shared.find()
        self._find_references()
        is_first, size = self._workspace is None, data.nworld * kernel.layout.workspace_size * (options.lanes > 1)
        if self._workspace is None or self._workspace.size < size:  # of another form, which takes less
            self._workspace = wp.empty(size, dtype=wp.float32, device=device)
            self._workspaces.append(self._workspace)
        if is_first and self._divided.others:
            self._count = wp.zeros(data.nworld, dtype=int, device=device)
            self._found = wp.zeros((data.nworld, contacts), dtype=int, device=device)
            self._given = wp.zeros((data.nworld, contacts, int(GIVEN_SIZE)), dtype=float, device=device)
        return kernel

    @cached_property
    def _hulls(self) -> HullTables:
        """The hulls of the meshes of which the kernel finds contacts."""
        return HullTables(self.mj_model, self._divided.pairs, self.model.device)

    @property
    def _asked(self) -> str:
        """What is asked of the kernel that the form for a hub with limbs does not have; empty if it has all."""
        asked = {
            "contacts of other collision detection": bool(self._divided.others),
            "contacts in MuJoCo Warp's arrays": self._fills_contacts,
            "accelerations of bodies": self._kept_bodies is not None,
            "external wrenches": "wrenches" in self._kinds,
        }
        return ", ".join(name for name, is_asked in asked.items() if is_asked)

    def _why_no_limbs(self) -> str:
        """Reason why the form for a hub with limbs that was asked for is not taken; empty if it is or was not."""
        if self.limbs is not True or self.fused.layout.is_limbs:
            return ""
        return f"asked for: {self._asked}" if self._asked else why_no_limbs(self.mj_model, self._divided.pairs)

    def _find_references(self) -> bool:
        """Find out whether any joint has a reference coordinate, as few models do; return whether that has changed."""
        references, had = self._references, self._has_references
        if references is not None and not references.device.is_capturing:  # a recording can read nothing back
            self._has_references = bool(np.any(references.numpy()))
        return self._has_references != had

    def _find_kinematic_bodies(self) -> bool:
        """Find out whether any body is kinematic, for which the kernel has code or not; return whether that is new."""
        flags, had = self.model.body_flags, self._has_kinematic_bodies
        if not had and flags is not None and not flags.device.is_capturing:
            self._has_kinematic_bodies = bool(np.any(flags.numpy() & int(newton.BodyFlags.KINEMATIC)))
        return self._has_kinematic_bodies != had

    @property
    def _references(self) -> wp.array | None:
        return getattr(getattr(self.model, "mujoco", None), "dof_ref", None)

    def _has_losses(self) -> bool:
        return bool(np.any(self.mjw_model.dof_frictionloss.numpy()))

    def _lanes(self, limbs: LimbForm | None) -> int:
        if limbs is not None:
            return limbs.slots
        few, many = _LANES
        return few if max(self.mj_model.nbody, self.mj_model.nv) <= few else many

    @cached_property
    def _layout(self) -> NewtonLayout | None:
        return NewtonLayout.of(self) if self._has_all_bodies() else None

    def _has_all_bodies(self) -> bool:
        bodies = self.mjc_body_to_newton.numpy()
        return np.array_equal(np.sort(bodies[bodies >= 0]), np.arange(self.model.body_count))

    def _limited_model(self) -> mujoco.MjModel:
        """The compiled model with the limits that MuJoCo Warp's has now: drives may have got some."""
        self.mj_model.actuator_forcelimited[:] = self.mjw_model.actuator_forcelimited.numpy().astype(bool)
        return self.mj_model

    def _notify_model_changed(self, flags: newton.ModelFlags | int) -> None:
        super()._notify_model_changed(flags)
        self._addresses.clear()  # it may have replaced arrays
        # A recording cannot compare worlds: what it changes has been told to `expect_changes`.
        compares = self._compares_worlds and not self.model.device.is_capturing
        if compares and self._shared.check(parameters_of_flags(flags)):
            self.has_stale_graphs = True
        joints = newton.ModelFlags.JOINT_DOF_PROPERTIES | newton.ModelFlags.JOINT_REFERENCE_POSE_PROPERTIES
        if compares and self._fused is not None and flags & joints and self._find_references():
            self.has_stale_graphs = True
        bodies = newton.ModelFlags.BODY_PROPERTIES
        if compares and self._fused is not None and flags & bodies and self._find_kinematic_bodies():
            self._remake()
            self.has_stale_graphs = True
        # A recording can read nothing back; what it changes are shapes of bodies, by events.
        reads = bool(flags & newton.ModelFlags.SHAPE_PROPERTIES) and not self.model.device.is_capturing
        if reads and self._division is not None and self._division.statics is not None:
            self._division.statics.check_unchanged(self.model)

    def _arguments(self, first: bool, last: bool) -> object:
        """Addresses of the arrays, for the first or the last step of a call or one between."""
        if last not in self._addresses:
            self._addresses[last] = self._refer_all(last)
        m = self._addresses[last]
        given = self._read_arrays(self._call, first) if self._call is not None else {}
        written = self._written_arrays(self._call) if last else {}
        for name in NEWTON_IN:
            setattr(m, name, _address(given.get(name)))
        for name in NEWTON_OUT:
            setattr(m, name, _address(written.get(name)))
        _refer(m, "overflow", self.mjw_data.overflow if self._overflow is None else self._overflow)
        m.overflow_seen, m.overflow_told = map(_address, self._told or (None, None))
        m.dt = self._dt
        return m

    def _read_arrays(self, call: _Call, first: bool) -> dict[str, wp.array]:
        """Arrays of :data:`NEWTON_IN` that a call reads, the joints before its first step alone."""
        state, control, per_step = call.state_in, call.control, self._per_step
        arrays = {"body_f": state.body_f, "velocity_limit": per_step.velocity_limit}
        arrays |= {"external_wrench": per_step.external_wrench, "wrench_in_world": per_step.wrench_in_world}
        if call.reads_state and first:
            arrays |= {"joint_q_in": state.joint_q, "joint_qd_in": state.joint_qd}
        if control is not None and control.joint_f is not None:
            arrays |= {name: getattr(control, name) for name in ("joint_f", "joint_target_q", "joint_target_qd")}
            arrays["controls"] = getattr(getattr(control, "mujoco", None), "ctrl", None)
        return arrays

    def _written_arrays(self, call: _Call | None) -> dict[str, wp.array]:
        """Arrays of :data:`NEWTON_OUT` that a call writes; without one those that Newton's conversion does not."""
        arrays = dict(self._accelerations)
        if call is not None:
            state = call.state_out
            arrays |= {"joint_q_out": state.joint_q, "joint_qd_out": state.joint_qd, "efforts": self._efforts(call)}
            arrays |= {"body_q": state.body_q, "body_qd": state.body_qd}
        if self._per_step.solver_drives is not None:
            arrays["computed_effort"] = self._per_step.solver_drives.computed_effort
        if self._before is not None:
            arrays |= dict(zip(("joint_q_before", "joint_qd_before"), self._before, strict=True))
        return arrays

    def _parameter_arrays(self) -> dict[str, wp.array]:
        places = {"": self.mjw_model, "opt": self.mjw_model.opt, "data": self.mjw_data}
        fields = {name: field.rpartition(".") for name, field in PARAMETERS.items()}
        return {name: getattr(places[owner], leaf) for name, (owner, _, leaf) in fields.items()}

    def _refer_all(self, last: bool) -> object:
        m, data = self.fused.arguments(), self.mjw_data
        for name in (*STATE, *OUTPUTS):
            _refer(m, name, getattr(data, name))
        for name, array in self._parameter_arrays().items():
            _refer(m, name, array, shared=name in self._shared.names)
        m.field_size, m.field_heights = self.mjw_model.hfield_size.ptr or 0, self.mjw_model.hfield_data.ptr or 0
        statics = self._divided.statics
        grids, hidden = (None, None) if statics is None else (statics.grids, statics.hidden_geoms)
        m.meshes = 0 if grids is None else grids.array.ptr
        m.hidden, m.hulls = _address(hidden), self._hulls.array.ptr
        m.workspace = _address(self._workspace)
        references = self._references if self._has_references else None
        own = {"newton_body": self.mjc_body_to_newton, "dof_ref": references}
        for name in NEWTON_MODEL:
            setattr(m, name, _address(own[name] if name in own else getattr(self.model, name)))
        m.eq_active = data.eq_active.ptr or 0
        if self._kept_bodies is not None:
            _refer(m, "bodies", self._kept_bodies)
        if self._divided.others:
            _refer(m, "contacts", self._given)
            m.contact_count = self._count.ptr
        if last and self._contact_forces is not None:
            _refer(m, "force_geoms", self._contact_forces.geoms)
            _refer(m, "contact_forces", self._contact_forces.forces)
        if last and self._fills_contacts:
            for name in CONTACTS:
                setattr(m, f"contact_{name}", getattr(data.contact, name).ptr)
            for name in READ:
                _refer(m, name, data.efc.force if name == "efc_force" else getattr(data, name))
        return m


def _field_of_efforts(state: newton.State) -> wp.array | None:
    """The field of a state for the forces of actuators, which Newton's observables replace."""
    return getattr(getattr(state, "mujoco", None), "qfrc_actuator", None)


def _address(array: wp.array | None) -> int:
    return 0 if array is None else array.ptr or 0


def _refer(arguments: Any, name: str, array: wp.array, shared: bool = False) -> None:
    """Set address and stride of an array whose first dimension is the world, in numbers of four bytes.

    Args:
        arguments: Arguments of the kernel.
        name: Name of the array in them.
        array: The array.
        shared: Whether all worlds read the row of the first one.
    """
    setattr(arguments, name, array.ptr or 0)
    setattr(arguments, f"{name}_stride", 0 if shared or array.shape[0] == 1 else array.strides[0] // 4)
