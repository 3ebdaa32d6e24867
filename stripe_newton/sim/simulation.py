# SPDX-License-Identifier: Apache-2.0
"""Simulation: Newton's model, state and solver, stepped as a CUDA graph."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from typing import Annotated

import newton
import numpy as np
import torch
import warp as wp

from stripe_newton.configclass import configclass
from stripe_newton.solvers import SolverFused
from stripe_newton.value_types import PositiveInt, Range, short

from .body_choice import BodyChoice
from .capture import capture_graph
from .finite_state import FiniteState
from .mujoco_solver_cfg import MuJoCoSolverCfg
from .replication import put_choices, put_unmoved, replicate
from .reset_mask import ResetMask
from .simulation_parts import SimulationParts
from .solver_cfg_base import SolverCfg
from .spawners.materials import RigidBodyMaterialCfg
from .start_trial import fit_buffers

__all__ = ["Simulation", "SimulationCfg"]


@configclass
class SimulationCfg:
    """Settings of a :class:`Simulation`: time step, gravity, device, solver."""

    device: str | None = None
    """``"cpu"``, ``"cuda"`` or ``"cuda:N"``. Default: the first GPU where there is one, else the CPU."""
    dt: Annotated[float, Range(above=0.0, at_most=1.0)] = 1.0 / 60.0
    """Time step of the physics [s]."""
    render_interval: PositiveInt = 1
    """Physics steps between updates of the live viewer of ``stripe-newton play``."""
    gravity: tuple[float, float, float] | None = (0.0, 0.0, -9.81)
    """Gravity in the world frame [m/s^2]. ``None`` takes the stage's own."""
    physics_material: RigidBodyMaterialCfg = RigidBodyMaterialCfg()
    """Material of colliders that have none of their own."""
    solver: SolverCfg = MuJoCoSolverCfg()
    """The solver and its options."""
    contact_forces: bool = False
    """Export contact forces in every step; :meth:`SceneQuerier.get_contact_forces` then does not compute them anew."""
    observables: Sequence[str] = ()
    """Arrays that the solver reports beyond the state, by Newton's names: ``"body_qdd"`` for accelerations of bodies,
    ``"body_parent_f"`` for the wrenches of their joints."""
    on_overflow: str = "grow"
    """Reaction to contacts or constraints that did not fit into the solver's buffers: ``"grow"`` does the step again
    with larger ones, on the CPU, see :class:`.growing_buffers.GrowingBuffers`; where that is not possible it is as
    ``"raise"``. ``"raise"`` and ``"warn"`` name the size to set. It is reported without host synchronisation, so on a
    GPU the message may come some steps late."""
    use_cuda_graph: bool = True
    """Replay the physics as one CUDA graph (on a GPU). Switch off to debug a kernel."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.on_overflow not in ("grow", "raise", "warn"):
            yield "on_overflow", f"is '{self.on_overflow}', must be 'grow', 'raise' or 'warn'"
        if self.device is not None and self.device.split(":")[0] not in ("cpu", "cuda"):
            yield "device", f"is '{self.device}', must be 'cpu', 'cuda' or 'cuda:N'"


class Simulation(SimulationParts):
    """Owns model, state, control, contacts and solver, and the graph that steps them.

    A scene builds it by :meth:`build`; several may live in one process, on different devices.
    """

    def build(
        self,
        template: newton.ModelBuilder,
        static: newton.ModelBuilder,
        env_origins: np.ndarray,
        allow_static: bool = False,
        unmoved: range = range(0),
        try_start: bool = False,
        body_choices: Sequence[BodyChoice] = (),
    ) -> None:
        """Replicate ``template`` at ``env_origins`` beside ``static`` and make the solver.

        Args:
            template: One environment at the origin.
            static: What all environments share; it may hold no bodies.
            env_origins: Origins in the world frame [m], shape ``(num_envs, 3)``.
            allow_static: Accept a template in which nothing moves; steps then do nothing.
            unmoved: Joints of the template whose bodies stand where the template has them, whatever the origin.
            try_start: Size the solver's buffers by a trial of the first second, where they cannot grow later.
            body_choices: Bodies of the template that are another asset in each environment.

        Raises:
            ValueError: if nothing can move and that is not allowed, or what is shared could.
        """
        start = time.perf_counter()
        if static.body_count:
            raise ValueError(
                f"rigid body '{static.body_label[0]}' stands outside the environments: "
                "only static colliders may be shared, put it below '/World/envs/env_.*'"
            )
        if not template.joint_count and not allow_static:
            raise ValueError("the environments hold no rigid body and no articulation: there is nothing to simulate")
        self.template, self.static, self.env_origins = template, static, np.asarray(env_origins, dtype=np.float32)
        self.num_envs, self.shared_shape_count = len(env_origins), static.shape_count
        if self.env_origin is None:
            self.env_origin = wp.array(self.env_origins, dtype=wp.vec3, device=self.device)
        builder = replicate(self.new_builder(), template, static, self.env_origins, self.cfg.gravity)
        if len(unmoved):
            put_unmoved(builder, template, self.num_envs, unmoved)
        self.body_choices = body_choices
        put_choices(builder, template, self.num_envs, self.shared_shape_count, body_choices)
        with wp.ScopedDevice(self.device):
            asked = self.cfg.solver  # which may leave a choice to what the model needs
            self._make_all(builder, asked)
            if try_start and self._physics.growing is None and self.cfg.on_overflow == "grow":
                fit_buffers(self, lambda sizes: self._make_all(builder, asked.replace(**sizes)))
        self.forward()
        self.build_s = time.perf_counter() - start

    # -- stepping

    def step(self, substeps: int = 1) -> None:
        """Advance the physics by ``substeps`` time steps: one graph launch on a GPU.

        The first call of each number of substeps runs eagerly and records the graph.

        Raises:
            ValueError: if the number of steps is no whole number of at least 0.
            RuntimeError: if the simulation is closed, and as :meth:`begin_step`.
        """
        if isinstance(substeps, bool) or not isinstance(substeps, (int, np.integer)) or substeps < 0:
            raise ValueError(f"Simulation.step: number of steps: is {short(substeps)}, must be 0 or more")
        self.begin_step()
        graph = self._graphs.get(substeps)
        if graph is not None:
            wp.capture_launch(graph)
            return
        with wp.ScopedDevice(self.device):
            # Eagerly first: what kernels compile and solvers allocate on first use cannot be part of a recording.
            self.launch(substeps)
            if self.device != "cpu" and self.cfg.use_cuda_graph:
                self._graphs[substeps] = capture_graph(self.device, lambda: self.launch(substeps))
        self.end_step()

    def begin_step(self) -> None:
        """Do the host's part of a step, before the physics: notify the solver of moved roots, report an overflow.

        Raises:
            RuntimeError: if contacts or constraints were dropped; see :meth:`check_overflow`.
            FloatingPointError: if the state is not finite and :meth:`watch_finite` was called.
        """
        if self.closed:
            raise RuntimeError("the simulation is closed; make a new one")
        if self.turns_wrenches:
            self.flush()
        self._forward_pending = False  # the solver computes the bodies from the joints
        self._bodies_pending = self._leaves_bodies
        if self.roots_moved:
            self.roots_moved = False
            self.notify(newton.ModelFlags.JOINT_PROPERTIES)
        self.check_overflow()
        if self._finite is not None:
            self._finite.check()

    def end_step(self) -> None:
        """Do the host's part of a step, after the physics: on the CPU, report what this step did.

        Raises:
            RuntimeError: as :meth:`begin_step`.
            FloatingPointError: as :meth:`begin_step`.
        """
        if self.device == "cpu":
            self.check_overflow()
            if self._finite is not None:
                self._finite.check()

    def watch_finite(self) -> None:
        """Let a step raise ``FloatingPointError`` once the state is not finite, as of the last report from the device.

        On the CPU it is the step that made it so.
        """
        if self._finite is None and not self.is_static:
            self._finite = FiniteState(self)
            self.add_hook(self._finite)

    def launch(self, substeps: int, before_each: Callable[[], None] | None = None) -> None:
        """Launch the kernels of some time steps, as :meth:`step` does but without a graph of its own.

        Args:
            substeps: Number of time steps.
            before_each: Launches what is to run before each of them.
        """
        if self.is_static:
            return
        self._physics.launch(substeps, before_each)

    @property
    def steps_together(self) -> bool:
        """Whether the physics steps of a call need nothing between them, and the solver takes them in one go."""
        return self._physics.together

    @property
    def turns_wrenches(self) -> bool:
        """Whether a physics step turns wrenches by the poses of bodies before the solver has computed these."""
        return self.external_wrench is not None and not self._physics.in_solver

    def compile_ahead(self) -> None:
        """Begin to compile the solver's kernel, if it has one for all of a step, which the first step waits for."""
        if not self.is_static:
            self._physics.compile_ahead()

    def expect_changes(self, names: Iterable[str]) -> None:
        """Expect that environments will differ in arrays of the model, which the solver may have taken for equal.

        Args:
            names: Names of attributes of ``newton.Model``.
        """
        if isinstance(self.solver, SolverFused):
            self.solver.expect_changes(names)
            self.drop_stale_graphs()

    def drop_stale_graphs(self) -> None:
        """Record the graphs again if the solver has found environments to differ that were equal when it recorded."""
        if isinstance(self.solver, SolverFused) and self.solver.has_stale_graphs:
            self.solver.has_stale_graphs = False
            self.recapture()

    def limit_velocities(self) -> None:
        """Enforce :attr:`velocity_limit` from the next step on."""
        self._physics.limits_velocity = True
        self.recapture()

    def enable_external_wrench(self) -> None:
        """Allocate :attr:`external_wrench` and apply it from the next step on."""
        if self.external_wrench is None:
            with wp.ScopedDevice(self.device):
                self.external_wrench = wp.zeros(self.model.body_count, dtype=wp.spatial_vector)
                self.wrench_in_world = wp.zeros(self.model.body_count, dtype=wp.bool)
            self.recapture()

    def check_overflow(self) -> None:
        """Raise, or warn, if contacts or constraints were dropped since the last call.

        It looks at what the device has reported so far, without host synchronisation.

        Raises:
            RuntimeError: naming the size to set in :class:`MuJoCoSolverCfg`.
        """
        message = "; ".join(filter(None, [hook.report_overflow() for hook in self.hooks]))
        if message and self.cfg.on_overflow != "warn":
            raise RuntimeError(message)
        if message:
            warnings.warn(message, stacklevel=2)

    def discard_overflow(self) -> None:
        """Discard reports of what was dropped so far, as by steps of a trial; wait for the device before."""
        for hook in self.hooks:
            hook.report_overflow()

    def clear_solver(self, env_mask: torch.Tensor | ResetMask) -> None:
        """Forget what the solver carries from step to step (warm start, activations) in the given environments.

        Without it a world that once became non-finite would stay so. The call may be captured.

        Args:
            env_mask: bool, shape ``(num_envs,)``, or the reset mask of an environment, which is not copied.
        """
        mask = env_mask if isinstance(env_mask, ResetMask) else self._cleared
        if isinstance(env_mask, torch.Tensor):
            mask.choose(env_mask)
        with wp.ScopedDevice(self.device):
            # flags=0: the state stays as it is, nothing but the solver's own memory is cleared.
            self.solver.reset(self._state, world_mask=mask.worlds, flags=0)
            self.actuation.reset(mask.array)

    # -- the model

    def refresh_drives(self) -> None:
        """Take over changed drive gains; :meth:`notify` and every physics step do so too."""
        with wp.ScopedDevice(self.device):
            self.actuation.hide_gains()

    def notify(self, flags: newton.ModelFlags | int, expected: bool = False) -> None:
        """Notify the solver that properties of the model were changed in place.

        Args:
            flags: Which properties; :func:`stripe_newton.sim.model_update.model_flags` finds them by name.
            expected: Whether :meth:`expect_changes` knows of them: nothing then waits for the device to compare the
                environments.
        """
        with wp.ScopedDevice(self.device):
            expected_changes = (
                self.solver.changes_expected() if expected and isinstance(self.solver, SolverFused) else nullcontext()
            )
            with self.actuation.solver_gains(), expected_changes:
                self.actuation.hide_gains()
                self.solver.notify_model_changed(flags)
            self.drop_stale_graphs()
            for hook in self.hooks:
                hook.launch_after_notify()

    def close(self) -> None:
        """Release graphs, solver and model."""
        self.closed = True
        self._graphs.clear()
        self.hooks.clear()  # they hold solver and model, too
        self.__dict__.pop("model", None)
        self.__dict__.pop("solver", None)
        self.__dict__.pop("_physics", None)
