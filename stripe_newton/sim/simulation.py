# SPDX-License-Identifier: Apache-2.0
"""Simulation: Newton's model, state and solver, stepped as a CUDA graph."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING, Annotated

import newton
import numpy as np
import torch
import warp as wp

from stripe_newton.actuators.actuation import Actuation
from stripe_newton.collision_tables import finalize_without_tables
from stripe_newton.configclass import configclass
from stripe_newton.forward_only import leave_out_gradients
from stripe_newton.solvers import SolverFused
from stripe_newton.usd import Light
from stripe_newton.usd.inertia_balance import SMALLEST_INERTIA
from stripe_newton.value_types import PositiveInt, Range, short

from .absent_shapes import AbsentShapes
from .body_choice import BodyChoice
from .capture import capture_graph
from .connect_anchors import ConnectAnchors
from .device import resolve_device
from .drive_limits import DriveLimits
from .finite_state import FiniteState
from .growing_buffers import GrowingBuffers
from .observables import wanted_observables
from .overflow import SolverOverflow
from .physics_hook import PhysicsHook
from .physics_step import PhysicsStep
from .replicated_model import finalize_replicated
from .replication import absent_shapes, put_choices, put_unmoved, replicate
from .reset_mask import ResetMask
from .solver_cfg import MuJoCoSolverCfg, SolverCfg
from .spawners.materials import RigidBodyMaterialCfg
from .start_trial import fit_buffers
from .static_solver import SolverStatic, complete_state

if TYPE_CHECKING:
    from stripe_newton.viewers.markers import VisualizationMarkers

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


class Simulation:
    """Owns model, state, control, contacts and solver, and the graph that steps them.

    A scene builds it by :meth:`build`; several may live in one process, on different devices. :attr:`state` is one
    object for life: every view of its arrays stays valid.
    """

    # -- there from the start

    cfg: SimulationCfg
    """The settings."""
    device: str
    """``"cpu"`` or ``"cuda:N"``."""
    decimation: int = 1
    """Physics steps in a step of the environment, in which sensors count their periods."""
    lights: list[Light]
    """Lights of the scene, for rendering."""
    markers: list[VisualizationMarkers]
    """Markers that viewers draw."""
    hooks: list[PhysicsHook]
    """Hooks of the physics, in the order in which they run; see :meth:`add_hook`."""
    env_origin: wp.array | None
    """Origins of the environments as they are now, on the device [m], shape ``(num_envs,)``: a terrain moves them."""
    closed: bool = False
    """Whether :meth:`close` was called."""
    recaptures: int = 0
    """Number of calls of :meth:`recapture`; an environment compares it, to record its own graph again."""
    roots_moved: bool = False
    """Set it after moving the frame that a fixed base is fixed to; the solver is notified before the next step."""

    # -- there once it is built

    num_envs: int = 0
    """Number of environments, each a Newton world."""
    model: newton.Model
    """The model of all environments."""
    solver: newton.solvers.SolverBase
    """The solver."""
    actuation: Actuation
    """All actuators of the model."""
    control: newton.Control
    """Targets and efforts of the joints."""
    pipeline: newton.CollisionPipeline | None
    """Newton's collision detection; None where the solver finds contacts itself."""
    contact_capacity: int | None
    """Contacts of all environments that Newton's collision detection has room for; None for as many as it estimates."""
    contacts: newton.Contacts | None
    """Contacts that the pipeline finds or the solver exports; None if neither does."""
    observables: newton.solvers.SolverBase.Observables | None
    """Arrays that the solver reports beyond the state; see :meth:`reported`."""
    drive_limits: DriveLimits | None = None
    """Effort limits of MuJoCo's drives, if ``MuJoCoSolverCfg.drive_limits`` asks for them."""
    template: newton.ModelBuilder
    """Builder of one environment, at the origin."""
    newton_contacts_for: tuple[str, ...] = ()
    """What of the scene asks for Newton's collision detection, to be named in :meth:`describe_solver`."""
    body_choices: Sequence[BodyChoice] = ()
    """Bodies that are another asset in each environment."""
    absent_shapes: AbsentShapes | None = None
    """Shapes that some environments lack; None if all have all."""
    static: newton.ModelBuilder
    """Builder of what all environments share, as it is now: ``scene.regenerate`` may have replaced it."""
    shared_shape_count: int = 0
    """Shapes of the model that all environments share; they come first."""
    env_origins: np.ndarray
    """Origins at which the environments were built, world frame [m], shape ``(num_envs, 3)``."""
    velocity_limit: wp.array
    """Velocity limits that are enforced after each step, shape ``(joint_dof_count,)``; see :meth:`limit_velocities`."""
    external_wrench: wp.array | None = None
    """External wrenches about the centres of mass, shape ``(body_count,)``, after :meth:`enable_external_wrench`."""
    wrench_in_world: wp.array
    """Whether each external wrench is in the world frame or in its body's, bool, shape ``(body_count,)``."""
    previous_joint_qd: wp.array
    """Joint velocities before the last physics step, for accelerations, shape ``(joint_dof_count,)``."""
    articulation_mask: wp.array
    """Articulations that :meth:`forward_masked` updates, bool, shape ``(articulation_count,)``."""
    build_s: float = 0.0
    """Seconds that :meth:`build` took."""

    def __init__(self, cfg: SimulationCfg):
        cfg.validate()
        if wp.config.log_level == wp.LOG_INFO and type(wp.get_logger()).__module__.startswith("warp"):
            wp.config.log_level = wp.LOG_WARNING  # else Warp prints a line for each of some hundred kernels
        self.cfg = cfg
        self.device = resolve_device(cfg.device)
        self.lights, self.markers, self.hooks = [], [], []
        self.env_origin = None
        self._graphs: dict[int, wp.Graph] = {}
        self._finite: FiniteState | None = None
        self.contact_capacity: int | None = None
        self._forward_pending = False

    @property
    def physics_dt(self) -> float:
        """Time step of the physics [s]."""
        return float(self.cfg.dt)

    @property
    def is_static(self) -> bool:
        """Whether nothing in the environments can move."""
        return not self.template.joint_count

    # -- building

    def new_builder(self) -> newton.ModelBuilder:
        """An empty builder with the solver's attributes and the default material of the settings."""
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        self.cfg.solver.register(builder)
        leave_out_gradients()  # here, as the solver is imported by now and nothing was launched yet
        builder.inertia_absolute_tolerance = SMALLEST_INERTIA
        material = self.cfg.physics_material
        builder.default_shape_cfg.mu = material.dynamic_friction
        builder.default_shape_cfg.restitution = material.restitution
        if material.density is not None:
            builder.default_shape_cfg.density = material.density
        if self.cfg.gravity is not None:
            builder.gravity = wp.vec3(*self.cfg.gravity)
        return builder

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

    def _make_all(self, builder: newton.ModelBuilder, solver: SolverCfg) -> None:
        """Make the model, the solver, and their hooks and buffers; again if a trial of the start needs larger ones."""
        self.cfg = self.cfg.replace(solver=solver)
        self.hooks.clear()
        self._make_solver(builder, tables=not self.is_static and self.cfg.solver.expects_newton_contacts(builder))
        absent = absent_shapes(self.template, self.num_envs, self.shared_shape_count, self.body_choices)
        if len(absent):
            self.absent_shapes = AbsentShapes(self.solver, absent)
            self.add_hook(self.absent_shapes)
        if self.cfg.solver.limits_drives and not self.is_static:
            self.drive_limits = DriveLimits(self.solver)
            self.add_hook(self.drive_limits)
        if isinstance(self.solver, newton.solvers.SolverMuJoCo):
            connects = ConnectAnchors(self.solver)
            if connects.corrected:
                self.add_hook(connects)
        self._allocate()

    def _make_solver(self, builder: newton.ModelBuilder, tables: bool) -> None:
        """Make the model, its actuators and its solver, which may choose Newton's collision detection.

        Args:
            builder: The builder of all environments.
            tables: Make what that collision detection wants to know of convex meshes.
        """
        finalize = partial(finalize_replicated, shared=self.shared_shape_count, device=self.device)
        self.model = finalize(builder) if tables else finalize_without_tables(builder, self.device, finalize)
        # The actuators take over the gains first: the solver must be made from those of its own drives alone.
        has_modes = self.cfg.solver.kind == "mujoco"
        self.actuation = Actuation(
            self.model, self.num_envs, self.physics_dt, has_modes, use_graph=self.cfg.use_cuda_graph
        )
        with self.actuation.solver_gains():
            make = SolverStatic if self.is_static else self.cfg.solver.create
            forces = ["contact_f"] if self.cfg.contact_forces else []
            self.solver = make(self.model, [*self.cfg.observables, *forces])
        if isinstance(self.solver, SolverFused):
            self.solver.newton_contacts_for += self.newton_contacts_for
        if self.cfg.solver.chooses_contacts and not getattr(self.solver, "_use_mujoco_contacts", True):
            if not tables and newton.GeoType.CONVEX_MESH in builder.shape_type:
                self._make_solver(builder, tables=True)
            else:
                self.cfg = self.cfg.replace(solver=self.cfg.solver.replace(use_mujoco_contacts=False))

    def _allocate(self) -> None:
        model = self.model
        self._state = model.state()
        if self.is_static:
            complete_state(self._state)
        self._physics = PhysicsStep(self, self._state)
        self.control = model.control()
        self.actuation.bind(self._state, self.control)
        self.velocity_limit = wp.full(model.joint_dof_count, value=float("inf"), dtype=float)
        self.previous_joint_qd = wp.clone(self._state.joint_qd)
        self._cleared = ResetMask(self.num_envs, self.device)
        self.articulation_mask = wp.zeros(model.articulation_count, dtype=wp.bool)
        self.pipeline = None if self.cfg.solver.finds_contacts else self._collision_detection()
        self.contacts = self.pipeline.contacts() if self.pipeline else None
        self._allocate_observables()
        self._physics.prepare()

    def _collision_detection(self) -> newton.CollisionPipeline:
        """Newton's collision detection, which by default goes through a list of all pairs that may touch."""
        many = isinstance(self.solver, SolverFused) and len(self.solver.hidden_shapes) > 0
        options = {"broad_phase": "sap"} if many else {}
        return newton.CollisionPipeline(self.model, rigid_contact_max=self.contact_capacity, **options)

    def _allocate_observables(self) -> None:
        """Allocate what the solver reports beyond the state."""
        if self.is_static:
            self.observables = None
            return
        wanted = wanted_observables(self.solver, self.cfg.observables, self.cfg.contact_forces)
        if self.cfg.contact_forces and self.contacts is None:
            # The solver writes its own contacts there, for the forces to refer to.
            self.contacts = newton.Contacts(self.solver.get_max_contact_count(), 0, device=self.device)
        self.observables = self.solver.observables(wanted, contacts=self.contacts) if wanted else None
        if self.observables is not None and "overflow" in wanted:
            self.add_hook(SolverOverflow(self.solver, self.observables))
        self._physics.growing = GrowingBuffers.of(self)

    def add_hook(self, hook: PhysicsHook) -> None:
        """Add a hook to the physics, after those that were added before it.

        Add hooks before the first step: a graph that was recorded without one does not run it.
        """
        self.hooks.append(hook)

    def describe_solver(self) -> str:
        """Describe in a line what computes the physics, and why."""
        if self.is_static:
            return "nothing moves"
        if isinstance(self.solver, SolverFused):
            return self.solver.describe(self._physics.between)
        return "MuJoCo Warp" if self.cfg.solver.uses_mujoco_warp else f"Newton's {self.cfg.solver.solver_class}"

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

    def recapture(self) -> None:
        """Record the graphs again at the next step; call this after replacing an array that they read."""
        self._graphs.clear()
        self.recaptures += 1

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

    # -- state

    @property
    def state(self) -> newton.State:
        """The state, one object for life; asking for it completes what a step left for later."""
        self.flush()
        return self._state

    def flush(self) -> None:
        """Update the bodies of environments that were reset in the last step, if that was left for later.

        A step leaves it for later where nothing in it reads the bodies any more: the next physics step computes them.
        """
        if self._forward_pending:
            self._forward_pending = False
            self.forward_masked()

    def forward(self, env_mask: torch.Tensor | None = None) -> None:
        """Make body poses and velocities follow the joints.

        Args:
            env_mask: Environments to update, bool, shape ``(num_envs,)``. Default: all.
        """
        self.flush()
        mask = None
        if env_mask is not None and self.model.articulation_count:
            mask = self.articulation_mask
            wp.to_torch(mask).view(self.num_envs, -1)[:] = env_mask.unsqueeze(1)
        newton.eval_fk(self.model, self._state.joint_q, self._state.joint_qd, self._state, mask=mask)

    def defer_forward(self) -> None:
        """Leave :meth:`forward_masked` to the next reader of :attr:`state`, or to the next step of the physics."""
        self._forward_pending = True

    def forward_masked(self) -> None:
        """Make bodies follow the joints of the articulations in :attr:`articulation_mask`; may be captured."""
        state = self._state
        newton.eval_fk(self.model, state.joint_q, state.joint_qd, state, mask=self.articulation_mask)

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

    def per_env(self, array: wp.array, shared: int = 0) -> torch.Tensor:
        """A zero-copy view of a flat array, one row an environment: shape ``(num_envs, count, ...)``.

        Args:
            array: Array of the model, state or control.
            shared: Number of entries that all environments share; they come first and are left out.
        """
        return wp.to_torch(array)[shared:].unflatten(0, (self.num_envs, -1))

    def reported(self, name: str) -> wp.array | None:
        """An array that the solver reports beyond the state, by Newton's name; None if it was not requested."""
        if self.observables is None or not self.observables.is_requested(name):
            return None
        return getattr(self.observables, name)

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
