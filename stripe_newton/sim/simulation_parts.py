# SPDX-License-Identifier: Apache-2.0
"""Simulation parts: model, state, actuators, solver and buffers of a simulation, and how they are made.

The order matters. Actuators take over the gains before the solver is made, which then has those of its own drives
alone; hooks of the physics come before the buffers, whose sizes may be found by a trial of the first second.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import newton
import numpy as np
import torch
import warp as wp

from stripe_newton.actuators.actuation import Actuation
from stripe_newton.collision_tables import finalize_without_tables
from stripe_newton.forward_only import leave_out_gradients
from stripe_newton.solvers import SolverFused
from stripe_newton.usd import Light
from stripe_newton.usd.inertia_balance import SMALLEST_INERTIA

from .absent_shapes import AbsentShapes
from .body_choice import BodyChoice
from .compile_notice import CompileNotice
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
from .replication import absent_shapes
from .reset_mask import ResetMask
from .solver_cfg_base import SolverCfg
from .static_solver import SolverStatic, complete_state

if TYPE_CHECKING:
    from stripe_newton.viewers.markers import VisualizationMarkers

    from .simulation import SimulationCfg

__all__ = ["SimulationParts"]


class SimulationParts:
    """The parts of a simulation. :attr:`state` is one object for life: every view of its arrays stays valid."""

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
    """Parts of the scene that ask for Newton's collision detection, to be named in :meth:`describe_solver`."""
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
        CompileNotice.install()
        self.cfg = cfg
        self.device = resolve_device(cfg.device)
        self.lights, self.markers, self.hooks = [], [], []
        self.env_origin = None
        self._graphs: dict[int, wp.Graph] = {}
        self._finite: FiniteState | None = None
        self.contact_capacity: int | None = None
        self._forward_pending = self._bodies_pending = self._leaves_bodies = False

    @property
    def physics_dt(self) -> float:
        """Time step of the physics [s]."""
        return float(self.cfg.dt)

    @property
    def is_static(self) -> bool:
        """Whether nothing in the environments can move."""
        return not self.template.joint_count

    # -- construction

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
        if self._leaves_bodies and _may_read_bodies(hook):
            self._set_leaves_bodies(False)

    def describe_solver(self) -> str:
        """Describe in a line what computes the physics, and why."""
        if self.is_static:
            return "nothing moves"
        if isinstance(self.solver, SolverFused):
            return self.solver.describe(self._physics.between)
        return "MuJoCo Warp" if self.cfg.solver.uses_mujoco_warp else f"Newton's {self.cfg.solver.solver_class}"

    def recapture(self) -> None:
        """Record the graphs again at the next step; call this after replacing an array that they read."""
        self._graphs.clear()
        self.recaptures += 1

    # -- state

    @property
    def state(self) -> newton.State:
        """The state, one object for life; asking for it completes what a step left for later."""
        self.flush()
        return self._state

    def flush(self) -> None:
        """Update the bodies of environments that were reset in the last step, or all, if that was left for later.

        A step leaves it for later where nothing in it reads the bodies any more: the next physics step computes them.
        """
        if self._bodies_pending:
            self._bodies_pending = self._forward_pending = False
            newton.eval_fk(self.model, self._state.joint_q, self._state.joint_qd, self._state)
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
        self._forward_pending, self._bodies_pending = True, self._leaves_bodies

    def leave_bodies(self) -> None:
        """Leave poses and velocities of all bodies to the next reader of :attr:`state`, if the solver can.

        Call it before graphs are recorded, if nothing that they hold reads bodies. Physics steps then do not write
        them: of the flat quadruped's physics with 32,768 environments this saves 3 %.
        """
        joints = self.model.joint_articulation
        # Forward kinematics goes over articulations alone.
        follows = joints is not None and bool((joints.numpy() >= 0).all())
        if isinstance(self.solver, SolverFused) and follows and not any(map(_may_read_bodies, self.hooks)):
            self._set_leaves_bodies(True)

    def _set_leaves_bodies(self, leaves: bool) -> None:
        assert isinstance(self.solver, SolverFused)
        self._leaves_bodies, self.solver.writes_bodies = leaves, not leaves
        self.recapture()

    def forward_masked(self) -> None:
        """Make bodies follow the joints of the articulations in :attr:`articulation_mask`; may be captured."""
        state = self._state
        newton.eval_fk(self.model, state.joint_q, state.joint_qd, state, mask=self.articulation_mask)

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


def _may_read_bodies(hook: PhysicsHook) -> bool:
    """Whether a hook launches kernels around the physics, which may read poses or velocities of bodies."""
    return hook.follows_each_step or type(hook).launch_before_steps is not PhysicsHook.launch_before_steps
