# SPDX-License-Identifier: Apache-2.0
"""Start trial: steps of a copy of the first state, to size the solver's buffers before anybody relies on them."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import newton
import warp as wp

from stripe_kernels.actuation import note_overflow

from .growing_buffers import MOST_GROWTH, SOLVER_STATE, larger_sizes

if TYPE_CHECKING:
    from .simulation import Simulation

__all__ = ["fit_buffers"]

_SECONDS = 1.0
"""Time that is simulated: things fall onto the ground and onto each other [s]."""
_MOST_STEPS = 240
_PATIENCE_S = 3.0
"""Time that the trial may take, for scenes whose steps are slow [s]."""
_BLOCK = 8
"""Steps between two looks at the clock, for each of which the device has to be waited for."""
_MOST_DOFS_ON_CPU = 1000
"""Degrees of freedom of a world beyond which a step on the CPU takes seconds, and there is no trial."""


def fit_buffers(sim: Simulation, make_again: Callable[[dict[str, int]], None]) -> None:
    """Make a simulation anew with larger buffers as long as its first second overflows them.

    It is for where buffers cannot grow in a step, such as on a GPU, before anything refers to the model and a graph is
    recorded. What overflows them later is reported.

    Args:
        sim: The simulation, built and not stepped.
        make_again: Makes its model and solver with sizes that the fields of the solver's config get.

    Warns:
        UserWarning: which sizes have grown.
    """
    solver = sim.solver
    reports = isinstance(solver, newton.solvers.SolverMuJoCo) and not (solver.use_mujoco_cpu or solver.enable_sleeping)
    too_slow = sim.device == "cpu" and sim.template.joint_dof_count > _MOST_DOFS_ON_CPU
    if not reports or too_slow or sim.reported("overflow") is None:
        return
    first = sizes = _sizes(sim)
    while bits := _overflow_at_start(sim):
        njmax, nconmax = larger_sizes(bits, *sizes)
        if (njmax, nconmax) == sizes or njmax > MOST_GROWTH * first[0]:
            break
        if sim.pipeline is not None and sim.contacts is not None:
            sim.contact_capacity = 2 * sim.contacts.rigid_contact_max
        make_again({"njmax": njmax, "nconmax": nconmax})
        sizes = _sizes(sim)
    if sizes != first:
        what = f"njmax from {first[0]} to {sizes[0]}, nconmax from {first[1]} to {sizes[1]}"
        message = f"the solver's buffers are too small for the first second and are made larger, {what}"
        fields = f"MuJoCoSolverCfg(njmax={sizes[0]}, nconmax={sizes[1]})"
        warnings.warn(f"{message}; {fields} begins with that", stacklevel=2)


def _sizes(sim: Simulation) -> tuple[int, int]:
    """Capacities of a world: constraints and contacts."""
    data = sim.solver.mjw_data
    return data.njmax, max(1, data.naconmax // data.nworld)


def _overflow_at_start(sim: Simulation) -> int:
    """Overflow bits of the first second, after which state and solver are as before.

    Drives hold their initial targets; explicit actuators, hooks and sensors do not run. The device is waited for.
    """
    kept = [(array, wp.clone(array)) for array in _solver_arrays(sim.solver)]
    bits = _run(sim)
    for array, before in kept:
        wp.copy(array, before)
    sim.discard_overflow()  # the solver's kernel may have reported it
    return bits


def _run(sim: Simulation) -> int:
    solver, model = sim.solver, sim.model
    state, control, observables = model.state(), model.control(), solver.observables({"overflow"})
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    contacts = sim.pipeline.contacts() if sim.pipeline is not None else None
    seen, reported = wp.zeros(1, dtype=wp.int32), wp.zeros(1, dtype=wp.int32)
    steps, start = min(_MOST_STEPS, max(1, round(_SECONDS / sim.physics_dt))), None
    for step in range(steps):
        if sim.pipeline is not None:
            sim.pipeline.collide(state, contacts)
        solver.step(state, state, control, contacts, sim.physics_dt, observables=observables)
        bits = observables.overflow
        wp.launch(note_overflow, dim=len(bits), inputs=[bits], outputs=[seen, reported])
        if model.device.is_cpu or step % _BLOCK == 0:
            wp.synchronize_device(model.device)
            start = time.perf_counter() if start is None else start  # after kernels were compiled
            if time.perf_counter() - start > _PATIENCE_S:
                break
    return int(seen.numpy()[0])


def _solver_arrays(solver: newton.solvers.SolverMuJoCo) -> Iterator[wp.array]:
    """Arrays that MuJoCo Warp carries from step to step."""
    for name in SOLVER_STATE:
        array = getattr(solver.mjw_data, name)
        if array is not None and array.size:
            yield array
