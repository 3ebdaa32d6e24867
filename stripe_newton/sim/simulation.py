# SPDX-License-Identifier: Apache-2.0
"""The simulation: Newton's model, states and solver, stepped as a CUDA graph."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import newton
import numpy as np
import torch
import warp as wp

from stripe_kernels.actuation import apply_external_wrench, clamp_velocity, note_overflow
from stripe_newton.actuators.actuation import Actuation

from .capture import capture_graph
from .drive_limits import DriveLimits
from .flags import HostFlags
from .overflow import overflow_message
from .simulation_cfg import SimulationCfg

if TYPE_CHECKING:
    from stripe_newton.usd import Light

__all__ = ["Simulation", "resolve_device"]


def resolve_device(name: str | None) -> str:
    """``"cpu"`` or ``"cuda:N"`` for a device as a config names it.

    Raises:
        ValueError: for a device that this machine does not have.
    """
    count = wp.get_cuda_device_count()
    if name is None:
        return "cuda:0" if count else "cpu"
    if name == "cpu":
        return name
    index = int(name.partition(":")[2] or 0)
    if index >= count:
        have = ", ".join(["cpu", *(f"cuda:{i}" for i in range(count))])
        raise ValueError(f"device '{name}': this machine has {have}")
    return f"cuda:{index}"


class Simulation:
    """Owns model, state, control, contacts and solver, and the graph that steps them.

    A scene builds it by :meth:`build`; several may live in one process, on different devices. ``state`` is one
    object for life: every view of its arrays stays valid.

    Attributes:
        cfg: The settings.
        device: ``"cpu"`` or ``"cuda:N"``.
        num_envs: Number of environments, each a Newton world.
        template: Builder of one environment, at the origin.
        static: Builder of what all environments share, as it is now: another scene may have come since.
        shared_shape_count: Shapes of the model that all environments share; they come first.
        env_origins: Where the environments were built in the world frame [m], shape ``(num_envs, 3)``.
        env_origin: Where they start now, on the device [m], shape ``(num_envs,)``: a terrain moves them.
        lights: Lights of the scene, for rendering.
        build_s: Seconds that :meth:`build` took.
    """

    def __init__(self, cfg: SimulationCfg):
        cfg.validate()
        if wp.config.log_level == wp.LOG_INFO:
            wp.config.log_level = wp.LOG_WARNING  # else Warp prints a line for each of some hundred kernels
        self.cfg = cfg
        self.device = resolve_device(cfg.device)
        self.num_envs = self.shared_shape_count = 0
        self.lights: list[Light] = []
        self.env_origin: wp.array | None = None
        self.model: newton.Model
        self.build_s = 0.0
        self.pending = False
        """Whether :meth:`forward_masked` was left for later."""
        self.roots_moved = False
        """Set by whoever moved the frame that a fixed base is fixed to; the solver is told before the next step."""
        self.recaptures = 0
        """How often an array was replaced that graphs read; whoever captured the physics compares."""
        self._graphs: dict[int, wp.Graph] = {}
        self.decimation = 1
        """Physics steps in a step of the environment, in which sensors count their periods."""
        self.after_each: list[Callable[[], None]] = []
        """What launches kernels after every physics step."""
        self.before_steps: list[Callable[[], None]] = []
        """What launches kernels before the physics steps that are launched together."""
        self.losses: list[Callable[[], str]] = []
        """What says which sizes were too small since it was asked last, empty for none; see :meth:`check_overflow`."""
        self.drive_limits: DriveLimits | None = None
        """The effort limits of MuJoCo's drives, if ``MuJoCoSolverCfg.drive_limits`` wants them."""
        self.after_notify: list[Callable[[], None]] = []
        """What launches kernels after the solver was told of changes, see :meth:`notify`."""

    @property
    def state(self) -> newton.State:
        """The state, one object for life; asking for it completes what a step left for later."""
        self.flush()
        return self._state

    def flush(self) -> None:
        """Let the bodies follow the joints of the episodes that began in the last step, if that was left for later.

        A step leaves it where nothing in it reads the bodies any more: the next physics step computes them anew.
        """
        if self.pending:
            self.pending = False
            self.forward_masked()

    @property
    def physics_dt(self) -> float:
        """Time step of the physics [s]."""
        return float(self.cfg.dt)

    def new_builder(self) -> newton.ModelBuilder:
        """An empty builder with the solver's attributes and the default material of the settings."""
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        self.cfg.solver.register(builder)
        material = self.cfg.physics_material
        builder.default_shape_cfg.mu = material.dynamic_friction
        builder.default_shape_cfg.restitution = material.restitution
        if material.density is not None:
            builder.default_shape_cfg.density = material.density
        if self.cfg.gravity is not None:
            builder.gravity = wp.vec3(*self.cfg.gravity)
        return builder

    def build(self, template: newton.ModelBuilder, static: newton.ModelBuilder, env_origins: np.ndarray) -> None:
        """Replicate ``template`` at ``env_origins`` beside ``static`` and make the solver.

        Args:
            template: One environment at the origin.
            static: What all environments share; it may hold no bodies.
            env_origins: Origins in the world frame [m], shape ``(num_envs, 3)``.
        """
        start = time.perf_counter()
        if static.body_count:
            raise ValueError(
                f"rigid body '{static.body_label[0]}' stands outside the environments: "
                "only static colliders may be shared, put it below '/World/envs/env_.*'"
            )
        if not template.joint_count:
            raise ValueError("the environments hold no rigid body and no articulation: there is nothing to simulate")
        self.template, self.static, self.env_origins = template, static, np.asarray(env_origins, dtype=np.float32)
        self.num_envs, self.shared_shape_count = len(env_origins), static.shape_count
        if self.env_origin is None:
            self.env_origin = wp.array(self.env_origins, dtype=wp.vec3, device=self.device)
        builder = self.new_builder()
        builder.add_builder(static)
        builder.gravity = static.gravity if self.cfg.gravity is None else wp.vec3(*self.cfg.gravity)
        template.gravity = template.gravity if self.cfg.gravity is None else wp.vec3(*self.cfg.gravity)
        identity = wp.quat_identity()
        builder.replicate(
            template, self.num_envs, xforms=[wp.transform(wp.vec3(*map(float, o)), identity) for o in self.env_origins]
        )
        with wp.ScopedDevice(self.device):
            self.model = builder.finalize(device=self.device)
            knows_modes = self.cfg.solver.kind == "mujoco"
            self.actuation = Actuation(
                self.model, self.num_envs, self.physics_dt, knows_modes, use_graph=self.cfg.use_cuda_graph
            )
            with self.actuation.solver_gains():
                self.solver = self._create_solver()
            if getattr(self.cfg.solver, "drive_limits", False):
                self.drive_limits = DriveLimits(self.solver)
                self.after_notify.append(self.drive_limits.launch)
            self._allocate()
        self.forward()
        self.build_s = time.perf_counter() - start

    def _create_solver(self) -> newton.solvers.SolverBase:
        try:
            return self.cfg.solver.create(self.model)
        except Exception as error:
            if "stackAlloc" not in str(error):  # MuJoCo's own, when the contacts of the start do not fit its memory
                raise
            raise RuntimeError(
                "MuJoCo ran out of memory for the contacts at the start: bodies overlap there; "
                "give each asset its own 'init_state.pos'"
            ) from error

    def _allocate(self) -> None:
        model = self.model
        self._state = model.state()
        self._next = None if self.cfg.solver.in_place else model.state()
        self.control = model.control()
        self.actuation.bind(self._state, self.control)
        self.velocity_limit = wp.full(model.joint_dof_count, value=float("inf"), dtype=float)
        """Velocity limits that are enforced after each step, shape ``(joint_dof_count,)``."""
        self.external_wrench: wp.array | None = None
        """External wrenches about the centres of mass, shape ``(body_count,)``, once one was set."""
        self.previous_joint_qd = wp.clone(self._state.joint_qd)
        """Joint velocities before the last step, for accelerations."""
        self._world_mask = wp.zeros(self.num_envs + 1, dtype=wp.bool)
        self.articulation_mask = wp.zeros(model.articulation_count, dtype=wp.bool)
        """Articulations that :meth:`forward_masked` is about, shape ``(articulation_count,)``."""
        self._collide()
        self._observe()

    def _collide(self) -> None:
        self.pipeline = None if self.cfg.solver.finds_contacts else newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts() if self.pipeline else None

    def _observe(self) -> None:
        """Allocate what the solver reports beyond the state."""
        supported = {str(getattr(o, "value", o)) for o in self.solver.supported_observables}
        wanted = {"qfrc_actuator", "overflow"} & supported
        missing = [name for name in self.cfg.observables if name not in supported]
        if missing:
            raise ValueError(
                f"observables: {type(self.solver).__name__} does not report {', '.join(missing)}; "
                f"it has {', '.join(sorted(supported)) or 'none'}"
            )
        wanted |= set(self.cfg.observables)
        if self.cfg.contact_forces:
            if "contact_f" not in self.solver.supported_observables:
                raise ValueError(
                    f"contact_forces: {type(self.solver).__name__} does not report them, use MuJoCoSolverCfg"
                )
            wanted.add("contact_f")
            if self.contacts is None:
                self.contacts = newton.Contacts(self.solver.get_max_contact_count(), 0, device=self.device)
        self.observables = self.solver.observables(wanted, contacts=self.contacts) if wanted else None
        self._overflow, self._told = wp.zeros(1, dtype=wp.int32), HostFlags(1, self.device)
        if getattr(self.solver, "mjw_model", None) is not None:
            self.solver.mjw_model.opt.warn_overflow = 0  # else every world prints in every step

    # -- stepping

    def step(self, substeps: int = 1) -> None:
        """Advance the physics by ``substeps`` time steps: one graph launch on a GPU.

        The first call of each number of substeps runs eagerly and records the graph.
        """
        self.begin_step()
        graph = self._graphs.get(substeps)
        if graph is not None:
            wp.capture_launch(graph)
            return
        with wp.ScopedDevice(self.device):
            self.launch(substeps)
            if self.device != "cpu" and self.cfg.use_cuda_graph:
                self._graphs[substeps] = capture_graph(self.device, lambda: self.launch(substeps))

    def begin_step(self) -> None:
        """What the host does before the physics: tell the solver of roots that were moved, report an overflow.

        Raises:
            RuntimeError: if contacts or constraints were dropped; see :meth:`check_overflow`.
        """
        if self.external_wrench is not None:
            self.flush()  # its frame is the body's
        self.pending = False
        if self.roots_moved:
            self.roots_moved = False
            self.notify(newton.ModelFlags.JOINT_PROPERTIES)
        self.check_overflow()

    def recapture(self) -> None:
        """Record the graphs anew at the next step; for whoever replaced an array that they read."""
        self._graphs.clear()
        self.recaptures += 1

    def launch(self, substeps: int, before_each: Callable[[], None] | None = None) -> None:
        """Launch the kernels of some time steps, as :meth:`step` does but without a graph of its own.

        Args:
            substeps: Number of time steps.
            before_each: Launches what is to run before each of them.
        """
        for function in self.before_steps:
            function()
        for index in range(substeps):
            if before_each is not None:
                before_each()
            if index == substeps - 1:
                wp.copy(self.previous_joint_qd, self._state.joint_qd)
            self.actuation.launch(index, last=index == substeps - 1)
            self._substep()
            for function in self.after_each:
                function()

    def _substep(self) -> None:
        model, state, control, dt = self.model, self._state, self.control, self.physics_dt
        if self.external_wrench is not None:
            wp.launch(
                apply_external_wrench,
                dim=model.body_count,
                inputs=[state.body_q, self.external_wrench, self.wrench_in_world],
                outputs=[state.body_f],
            )
        if self.pipeline is not None:
            self.pipeline.collide(state, self.contacts)
        following_state = state if self._next is None else self._next
        with self.actuation.solver_gains():
            self.solver.step(state, following_state, control, self.contacts, dt, observables=self.observables)
        if self.observables is not None and self.observables.is_requested("overflow"):
            wp.launch(
                note_overflow,
                dim=self.num_envs,
                inputs=[self.observables.overflow],
                outputs=[self._overflow, self._told.array],
            )
        if self._next is not None:
            state.assign(self._next)
            if not self.cfg.solver.reduced_coordinates:
                newton.eval_ik(model, state, state.joint_q, state.joint_qd)
        if self._limits_velocity:
            wp.launch(clamp_velocity, dim=model.joint_dof_count, inputs=[self.velocity_limit], outputs=[state.joint_qd])
            newton.eval_fk(model, state.joint_q, state.joint_qd, state)

    _limits_velocity = False

    def limit_velocities(self) -> None:
        """Enforce :attr:`velocity_limit` from the next step on."""
        self._limits_velocity = True
        self.recapture()

    def enable_external_wrench(self) -> None:
        """Allocate :attr:`external_wrench` and apply it from the next step on."""
        if self.external_wrench is None:
            with wp.ScopedDevice(self.device):
                self.external_wrench = wp.zeros(self.model.body_count, dtype=wp.spatial_vector)
                self.wrench_in_world = wp.zeros(self.model.body_count, dtype=wp.bool)
            self.recapture()

    # -- state

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

    def clear_solver(self, env_mask: torch.Tensor) -> None:
        """Forget what the solver carries from step to step (warm start, activations) in the given environments.

        Without it a world that once became non-finite would stay so.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """
        wp.to_torch(self._world_mask)[:-1] = env_mask
        with wp.ScopedDevice(self.device):
            self.solver.reset(self._state, world_mask=self._world_mask, flags=0)
            self.actuation.reset(wp.from_torch(env_mask.contiguous(), dtype=wp.bool))

    def forward_masked(self) -> None:
        """Make bodies follow the joints of the articulations in :attr:`articulation_mask`; may be captured."""
        state = self._state
        newton.eval_fk(self.model, state.joint_q, state.joint_qd, state, mask=self.articulation_mask)

    def clear_masked(self, world_mask: wp.array, env_mask: wp.array) -> None:
        """:meth:`clear_solver` for masks on the device; may be captured.

        Args:
            world_mask: bool, shape ``(num_envs + 1,)``, the last one False.
            env_mask: The same environments, bool, shape ``(num_envs,)``.
        """
        self.solver.reset(self._state, world_mask=world_mask, flags=0)
        self.actuation.reset(env_mask)

    def refresh_drives(self) -> None:
        """Take over changed drive gains; :meth:`notify` and every physics step do so too."""
        with wp.ScopedDevice(self.device):
            self.actuation.hide_gains()

    def notify(self, flags: newton.ModelFlags | int) -> None:
        """Tell the solver which properties of the model were changed in place."""
        with wp.ScopedDevice(self.device), self.actuation.solver_gains():
            self.actuation.hide_gains()
            self.solver.notify_model_changed(flags)
        with wp.ScopedDevice(self.device):
            for function in self.after_notify:
                function()

    def per_env(self, array: wp.array, shared: int = 0) -> torch.Tensor:
        """A zero-copy view of a flat array, one row an environment: shape ``(num_envs, count, ...)``.

        Args:
            array: Array of the model, state or control.
            shared: Number of entries that all environments share; they come first and are left out.
        """
        return wp.to_torch(array)[shared:].unflatten(0, (self.num_envs, -1))

    def check_overflow(self) -> None:
        """Raise, or warn, if contacts or constraints were dropped since the last call, as far as the device has got.

        Raises:
            RuntimeError: naming the size to set in :class:`MuJoCoSolverCfg`.
        """
        messages = [lost() for lost in self.losses]
        if bits := self._told[0]:
            self._told[0] = 0
            self._overflow.zero_()
            messages.append(overflow_message(bits, self.solver))
        message = "; ".join(filter(None, messages))
        if message and self.cfg.on_overflow == "raise":
            raise RuntimeError(message)
        if message:
            warnings.warn(message, stacklevel=2)

    def close(self) -> None:
        """Release graphs, solver and model."""
        self._graphs.clear()
        self.__dict__.pop("model", None)
        self.__dict__.pop("solver", None)
