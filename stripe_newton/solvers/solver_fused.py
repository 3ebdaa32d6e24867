# SPDX-License-Identifier: Apache-2.0
"""Fused solver: MuJoCo's physics with the whole step of a world in one kernel, as a Newton solver."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import Any

import mujoco_warp
import newton
import numpy as np
import warp as wp

from .contact_pairs import MESH_KINDS
from .kernel_buffers import ContactForces
from .launch_arguments import ConvertedState, StepCall, efforts_field
from .per_step import PerStep
from .stand_ins import StandIns
from .step_kernel import StepKernel
from .step_launcher import StepLauncher
from .support import why_unsupported

__all__ = ["SolverFused"]

_NOT_HERE = {"use_mujoco_cpu": True, "use_speculative_contacts": True}
"""Arguments of SolverMuJoCo with the values that lead around the fused step, or that it would ignore."""
_OF_BODIES = ("body_qdd", "body_parent_f")
"""Accelerations and wrenches of bodies, which the kernel writes where somebody reads them."""


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
            step, and see :meth:`missing_triangle_contacts`.
        stand_ins: Static shapes that are no geoms, see :meth:`finds_hidden`; None for none.
        limbs: Whether a robot that is a hub with limbs, which touch nothing that moves, is stepped in a form for such
            robots, see ``docs/solvers.md``; None where it is faster. Set it before the first step.
        launcher: The kernel and its launches.
        newton_contacts_for: Kinds of pairs because of which contacts are Newton's, to be named in :meth:`describe`.
        has_stale_graphs: Whether graphs that were recorded before must be recorded again, as worlds were found to
            differ in what was the same in all of them, see :meth:`expect_changes`. Who records them sets it to False.
        writes_bodies: Whether a step that is one launch writes poses and velocities of bodies to the state. Without
            them the kernel leaves out a pass over the bodies.
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
        self.launcher = StepLauncher(self, model)  # first, as the constructor notifies
        self.has_stale_graphs = False
        self.writes_bodies = True
        self._call = StepCall()
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
        self._filled_dt = 0.0

    def _why_kinematic(self) -> str:
        """Reason not to step kinematic bodies: Newton places the welds that hold them anew before each step."""
        return "a body is kinematic or may become it" if self._kinematic_weld_eq is not None else ""

    # -- what it does

    def missing_triangle_contacts(self) -> list[str]:
        """Kinds of pairs of which contacts with triangles are needed and not found, see :func:`mark_triangles`."""
        return self.launcher.division.hull_kinds

    def finds_hidden(self) -> bool:
        """Whether contacts with shapes that are no geoms are found: MuJoCo Warp's collision detection would not."""
        if self.unsupported or self.missing_triangle_contacts():
            return False
        return any(pair.kind in MESH_KINDS.values() for pair in self.launcher.division.pairs)

    @property
    def uses_mujoco_contacts(self) -> bool:
        """Whether contacts are MuJoCo's and the kernel's own, rather than those that :meth:`step` is given."""
        return self._use_mujoco_contacts

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
        return not self.unsupported and self.launcher.newton_layout is not None

    @property
    def fused(self) -> StepKernel:
        """The kernel of the step, made at its first use."""
        return self.launcher.kernel

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
            return "the fused step, with MuJoCo Warp's collision detection for " + ", ".join(
                self.launcher.division.external_kinds
            )
        between = [*([] if self.converts else ["Newton's conversion of the state"]), *between]
        limbs = self.fused.layout.num_limbs
        form = f", of a hub with {limbs} limbs" if limbs > 1 else ""
        if self.limbs is True and not self.fused.layout.is_limbs:
            form += f", not of a hub with limbs ({self.launcher.choice.why_no_limbs()})"
        if between:
            return f"the fused step{form}, a launch for each physics step because of " + ", ".join(between)
        return f"the fused step{form}, all physics steps of a step in one launch"

    def why_bits_vary(self) -> str:
        """Reason why two runs may differ in last bits on a GPU; empty if the step gives the same ones each time."""
        return "MuJoCo Warp's threads add forces and list contacts in no fixed order" if self.unsupported else ""

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
        if self.unsupported or self.launcher.buffers.fills_contacts:
            return
        if not self._use_mujoco_contacts:  # Newton keeps what it knows of its contacts there, from step to step
            self.unsupported = "contacts of Newton's collision detection are read"
            return
        if len(self.hidden_shapes):
            raise RuntimeError(
                "contacts cannot be written to MuJoCo's arrays, as its model has not all static shapes: ask for "
                "'contact_f' among the observables of the simulation before it is built"
            )
        self.launcher.buffers.fills_contacts = True
        self.launcher.remake()
        self.launcher.buffers.mark_contacts_filled()

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
        if self.launcher.buffers.add_contact_forces():
            self.launcher.remake()
        return self.launcher.buffers.contact_forces

    def notify_buffers_enlarged(self) -> None:
        """Take other sizes of MuJoCo Warp's buffers from the next step on, in a kernel that is made for them.

        Graphs that were recorded before must not be replayed: see :meth:`Simulation.recapture`.
        """
        if self.unsupported:
            return
        self.launcher.buffers.enlarge()
        self.launcher.remake()

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
        self._call = StepCall(steps, before, per_step)
        try:
            contacts = observables.contacts if observables is not None else None
            self.step(state_in, state_out, control, contacts, dt, observables=observables)
        finally:
            self._call = StepCall()

    def prepare(self, per_step: PerStep) -> None:
        """Use a kernel with the features of ``per_step`` from the next step on."""
        if not per_step.kinds <= self.launcher.per_step:
            self.launcher.per_step |= per_step.kinds
            self.launcher.remake()

    def _enable_rne_postconstraint(self, state_out: newton.State, observables: Any = None) -> None:
        """Note which accelerations and wrenches of bodies the coming step has to write, and where."""
        if self.unsupported:
            super()._enable_rne_postconstraint(state_out, observables)
            return
        arrays: dict[str, wp.array] = {}
        for name in _OF_BODIES:
            asked = observables is not None and observables.is_requested(name)
            array = getattr(observables if asked else state_out, name)
            if array is not None:
                arrays[name] = array
        self._call = replace(self._call, body_outputs=arrays)
        if arrays:
            self._compute_accelerations()

    def _compute_accelerations(self) -> None:
        """Take a kernel that can compute accelerations of bodies from now on."""
        if self.launcher.buffers.add_bodies(self.mj_model.nbody):
            self.launcher.remake()

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
        call = self._call
        try:
            if not self.converts:
                super().step(state_in, state_out, control, contacts, dt, observables=observables)
                return
            converted = ConvertedState(state_in, state_out, control, observables)
            self._call = replace(call, state=converted)
            if self._does_all(observables):
                converted.writes_bodies = self.writes_bodies
                self._step_in_kernel(converted, contacts, dt)
            else:
                super().step(state_in, state_out, control, contacts, dt, observables=observables)
        finally:
            self._call = call

    def _does_all(self, observables: Any) -> bool:
        """Whether the kernel does all of a step, so that what the base class launches around it is left out."""
        if not self.converts or not self._use_mujoco_contacts or not self.one_launch:
            return False
        return observables is None or not observables.is_requested(self.ObservableKind.CONTACT_F)

    def _step_in_kernel(self, state: ConvertedState, contacts: newton.Contacts | None, dt: float) -> None:
        """Advance as the base class does, but for what the kernel does as well: time step, reports of overflows."""
        self.validate_observables(state.observables, contacts)
        with wp.ScopedDevice(self.model.device):
            self._enable_rne_postconstraint(state.state_out, state.observables)
            state.reads_state = self._update_data_interval > 0 and self._step % self._update_data_interval == 0
            if self._filled_dt != dt:  # others read it there
                self.mjw_model.opt.timestep.fill_(dt)
                self._filled_dt = dt
            observables = state.observables
            is_reported = observables is not None and observables.is_requested(self.ObservableKind.OVERFLOW)
            self._call = replace(self._call, dt=dt, overflow=observables.overflow if is_reported else None)
            self._mujoco_warp_step()
            self._update_newton_state(self.model, state.state_out, self.mjw_data, state.state_in, observables)
        self._step += 1

    def collect_overflow(self, seen: wp.array, unread: wp.array) -> None:
        """Let the kernel collect the overflow bits of all worlds from now on, see :meth:`collects_overflow`.

        Args:
            seen: Bits so far, int32, shape ``(1,)``.
            unread: The same for the host, in its memory, where new bits are written.
        """
        self.launcher.buffers.overflow_bits = seen, unread

    def collects_overflow(self, observables: Any) -> bool:
        """Whether the kernel collects all overflow bits of steps with these observables."""
        return self.launcher.buffers.overflow_bits is not None and self._does_all(observables)

    # The base class calls the following around a step. Where the kernel does what they do, they do nothing.

    def _apply_mjc_control(self, *args: Any, **kwargs: Any) -> None:
        if self._call.state is None:
            super()._apply_mjc_control(*args, **kwargs)

    def _update_mjc_data(self, *args: Any, **kwargs: Any) -> None:
        if self._call.state is None:
            super()._update_mjc_data(*args, **kwargs)
        else:
            self._call.state.reads_state = True

    def _update_newton_state(
        self, model: newton.Model, state: newton.State, mj_data: Any, state_prev: newton.State, observables: Any = None
    ) -> None:
        if self._call.state is None:
            super()._update_newton_state(model, state, mj_data, state_prev, observables)
            return
        self._update_body_observables(model, state, mj_data, observables)
        efforts, field = self._call.state.efforts, efforts_field(state)
        if efforts is not None and field is not None and field.ptr != efforts.ptr:
            wp.copy(field, efforts)

    def _update_body_observables(
        self, model: newton.Model, state: newton.State, mj_data: Any, observables: Any = None
    ) -> None:
        """Copy what the kernel has written to the state where that has such a field, too."""
        if self.unsupported or mj_data is not self.mjw_data:
            super()._update_body_observables(model, state, mj_data, observables)
            return
        for name, written in self._call.body_outputs.items():
            field = getattr(state, name)
            if field is not None and field.ptr != written.ptr:
                wp.copy(field, written)

    def _mujoco_warp_step(self) -> None:
        if self.unsupported:
            super()._mujoco_warp_step()
            return
        self.launcher.launch(self._call)

    # -- changes of the model

    def expect_changes(self, names: Iterable[str]) -> None:
        """Expect that worlds will differ in arrays of Newton's model, which may change within a recorded graph.

        A parameter that is the same in all worlds is read from the first one. :meth:`notify_model_changed` finds out
        where they differ, but waits for the device for that.

        Args:
            names: Names of attributes of ``newton.Model``.
        """
        if self.launcher.assumptions.expect_changes(names):
            self.launcher.clear_arguments()
            self.has_stale_graphs = True

    def changes_expected(self) -> AbstractContextManager[None]:
        """Context for :meth:`notify_model_changed` of changes that are expected: worlds are not compared again."""
        return self.launcher.assumptions.changes_expected()

    def _notify_model_changed(self, flags: newton.ModelFlags | int) -> None:
        with self._ordered_sums():
            super()._notify_model_changed(flags)
        self.launcher.clear_arguments()  # it may have replaced arrays
        if self.launcher.assumptions.check(flags, self.launcher.has_kernel):
            self.has_stale_graphs = True
        # A recording can read nothing back; what it changes are shapes of bodies, by events.
        reads = bool(flags & newton.ModelFlags.SHAPE_PROPERTIES) and not self.model.device.is_capturing
        if reads:
            self.launcher.check_static_meshes()

    @contextmanager
    def _ordered_sums(self) -> Iterator[None]:
        """Let MuJoCo Warp add floats in the same order each time.

        Inverse weights follow from its mass matrices, to which the inertias of three children of a body are added by
        atomics: the last bits of some worlds would differ from run to run.
        """
        option = self.mjw_model.opt
        before = option.deterministic
        option.deterministic = before | int(mujoco_warp.DeterminismType.ATOMICS)
        try:
            yield
        finally:
            option.deterministic = before
