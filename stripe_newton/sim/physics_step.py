# SPDX-License-Identifier: Apache-2.0
"""Physics step: the launches of physics time steps, in the solver's own kernel or one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import newton
import warp as wp

from stripe_kernels.actuation import apply_external_wrench, clamp_velocity
from stripe_kernels.actuators import JointDrives
from stripe_newton.solvers import PerStep, SolverFused

from .growing_buffers import GrowingBuffers

if TYPE_CHECKING:
    from .simulation_parts import SimulationParts

__all__ = ["PhysicsStep"]


class PhysicsStep:
    """Launches the time steps of a simulation.

    There are two ways. Where the kernel of the fused solver does all of a step (:attr:`in_solver`), actuators, wrenches
    and velocity limits run within it, and several steps may be one launch (:attr:`together`). Otherwise the parts of
    each step are launched one after the other: actuators, wrenches, collision detection, solver, velocity limits.

    Attributes:
        growing: Buffers of the solver that grow; None where they keep their sizes.
        limits_velocity: Whether ``sim.velocity_limit`` is enforced.
    """

    def __init__(self, sim: SimulationParts, state: newton.State):
        """Step a simulation whose model and solver are made.

        Args:
            sim: The simulation.
            state: Its state.
        """
        self._sim, self._state = sim, state
        # Where a solver cannot step in place. Its result is copied back.
        self._next = None if sim.cfg.solver.in_place else sim.model.state()
        self.growing: GrowingBuffers | None = None
        self.limits_velocity = False

    @property
    def in_solver(self) -> bool:
        """Whether the solver's kernel does all of a physics step: actuators, wrenches and velocity limits, too."""
        solver, actuation = self._sim.solver, self._sim.actuation
        inside = isinstance(solver, SolverFused) and solver.converts and self._sim.pipeline is None
        return inside and not actuation.networks and not actuation.drives_orientations

    @property
    def together(self) -> bool:
        """Whether nothing runs between physics steps, and the solver takes several in one launch."""
        return self.in_solver and not self.between

    @property
    def between(self) -> list[str]:
        """Names of what runs between physics steps."""
        sim, actuation, inside = self._sim, self._sim.actuation, self.in_solver
        networks = ", ".join(actuation.networks)
        names = {
            "Newton's collision detection": sim.pipeline is not None,
            f"actuators that Newton steps ({networks})": bool(networks),
            "laws in torch that change targets": bool(actuation.changed_targets),
            "explicit actuators of free or ball joints": actuation.drives_orientations,
            "explicit actuators": bool(actuation.explicit.any()) and not inside,
            "external wrenches": sim.external_wrench is not None and not inside,
            "velocity limits": self.limits_velocity and not inside,
        } | {type(hook).__name__: True for hook in sim.hooks if hook.follows_each_step}
        return [name for name, is_there in names.items() if is_there]

    def prepare(self) -> None:
        """Choose the features of the solver's kernel before it is compiled."""
        if self.in_solver:
            assert isinstance(self._sim.solver, SolverFused)
            self._sim.solver.prepare(self._per_step())

    def compile_ahead(self) -> None:
        """Begin to compile the solver's kernel, if it does all of a step; the first launch waits for it."""
        if self.in_solver:
            assert isinstance(self._sim.solver, SolverFused)
            self._sim.solver.compile_ahead(self._per_step())

    def launch(self, substeps: int, before_each: Callable[[], None] | None = None) -> None:
        """Launch some time steps.

        Args:
            substeps: Number of time steps.
            before_each: Launches what is to run before each of them.
        """
        for hook in self._sim.hooks:
            hook.launch_before_steps()
        if self.in_solver:
            together = max(substeps, 1) if before_each is None and self.together else 1
            for _ in range(0, substeps, together):
                if before_each is not None:
                    before_each()
                with self._sim.actuation.targets_of_step():
                    self._launch_in_solver(together)
            return
        for index in range(substeps):
            last = index == substeps - 1
            if before_each is not None:
                before_each()
            if last:  # accelerations are over the last physics step
                wp.copy(self._sim.previous_joint_qd, self._state.joint_qd)
            with self._sim.actuation.targets_of_step():
                self._sim.actuation.launch(index, last=last)
                self.launch_after_actuators()
            for hook in self._sim.hooks:
                hook.launch_after_step()

    def _per_step(self) -> PerStep:
        """Work of the solver's kernel in each physics step."""
        sim = self._sim
        return PerStep(
            drives=sim.actuation.drives if sim.actuation.explicit.any() else None,
            solver_drives=sim.actuation.drives,
            external_wrench=sim.external_wrench,
            wrench_in_world=None if sim.external_wrench is None else sim.wrench_in_world,
            velocity_limit=sim.velocity_limit if self.limits_velocity else None,
        )

    def _launch_in_solver(self, substeps: int) -> None:
        """Launch some time steps of which the solver's kernel does all."""
        sim, state, solver = self._sim, self._state, self._sim.solver
        assert isinstance(solver, SolverFused)
        per_step, before = self._per_step(), (None, sim.previous_joint_qd)
        self._solve(
            lambda: solver.step_many(
                state, state, sim.control, sim.physics_dt, substeps, sim.observables, before, per_step
            ),
            per_step.drives,
        )
        for hook in sim.hooks:
            hook.launch_after_step()

    def launch_after_actuators(self) -> None:
        """Launch what follows the actuators in a time step: wrenches, collision detection, solver, velocity limits."""
        sim, model, state = self._sim, self._sim.model, self._state
        if sim.external_wrench is not None:
            wp.launch(
                apply_external_wrench,
                dim=model.body_count,
                inputs=[state.body_q, sim.external_wrench, sim.wrench_in_world],
                outputs=[state.body_f],
            )
        if sim.pipeline is not None:
            sim.pipeline.collide(state, sim.contacts)
        following = state if self._next is None else self._next
        with sim.actuation.solver_gains():  # solvers without drive modes read the gains in every step
            self._solve(
                lambda: sim.solver.step(
                    state, following, sim.control, sim.contacts, sim.physics_dt, observables=sim.observables
                )
            )
        if self._next is not None:
            # The result is copied back rather than the states swapped: views and graphs hold the arrays of one state.
            state.assign(self._next)
            if not sim.cfg.solver.reduced_coordinates:  # such solvers move bodies, and leave the joints behind
                newton.eval_ik(model, state, state.joint_q, state.joint_qd)
        if self.limits_velocity:
            wp.launch(clamp_velocity, dim=model.joint_dof_count, inputs=[sim.velocity_limit], outputs=[state.joint_qd])
            newton.eval_fk(model, state.joint_q, state.joint_qd, state)

    def _solve(self, launch: Callable[[], None], drives: JointDrives | None = None) -> None:
        """Launch the solver's part of a step, with buffers that grow where they can."""
        if self.growing is None:
            launch()
        else:
            self.growing.run(launch, drives)
