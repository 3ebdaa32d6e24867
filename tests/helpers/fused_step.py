# SPDX-License-Identifier: Apache-2.0
"""The fused step beside MuJoCo's C: recorded states of a model, and the velocities of both after a step."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import warp as wp

from stripe_newton.solvers.model_tables import PARAMETERS, ModelTables
from stripe_newton.solvers.step_kernel import STATE, KernelOptions, step_kernel

MAX_ROWS, MAX_CONTACTS, CONTACT_SIZE = 200, 60, 31


@dataclass
class Comparison:
    """Results of a step in many states."""

    error: np.ndarray
    """Relative errors of the velocities, shape ``(n,)``."""
    rows: np.ndarray
    """Constraint rows of the fused step."""
    expected_rows: np.ndarray
    """Constraint rows of MuJoCo."""


def record(model: mujoco.MjModel, count: int, seed: int = 0) -> list[dict[str, np.ndarray]]:
    """States of a model that was kicked, driven and pushed at random."""
    rng, data, states = np.random.default_rng(seed), mujoco.MjData(model), []
    while len(states) < count:
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(size=model.nv) * rng.random()
        for step in range(60):
            if step % 10 == 0:
                data.ctrl[:] = rng.uniform(-1.0, 1.0, model.nu)
            data.qfrc_applied[:] = 0.1 * rng.normal(size=model.nv)
            data.xfrc_applied[1:] = rng.normal(size=(model.nbody - 1, 6))
            if rng.random() < 0.3:
                states.append({name: getattr(data, name).copy() for name in STATE})
            mujoco.mj_step(model, data)
    return states[:count]


def compare(model: mujoco.MjModel, count: int = 200, double: bool = True, given_contacts: bool = False) -> Comparison:
    """One step of the fused kernel on the CPU, and of MuJoCo in double precision, from the same states."""
    model.opt.tolerance, model.opt.ls_tolerance = 0.0, 1e-12
    model.opt.iterations = model.opt.ls_iterations = 100
    states, data = record(model, count), mujoco.MjData(model)
    velocities, rows = np.zeros((count, model.nv)), np.zeros(count, dtype=int)
    contacts, contact_counts = np.zeros((count, MAX_CONTACTS, CONTACT_SIZE)), np.zeros(count, dtype=np.int32)
    for i, state in enumerate(states):
        mujoco.mj_resetData(model, data)
        for name, value in state.items():
            getattr(data, name)[:] = value
        mujoco.mj_step(model, data)
        velocities[i], rows[i] = data.qvel, data.nefc
        active = [c for c in data.contact if not c.exclude and c.efc_address >= 0]
        contact_counts[i] = len(active)
        for k, contact in enumerate(active):
            contacts[i, k] = _numbers(model, contact)
    tolerance = 1e-15 if double else 1e-6
    options = KernelOptions(double=double, tolerance=tolerance, given_contacts=given_contacts)
    kernel = step_kernel(ModelTables.of(model, MAX_ROWS, MAX_CONTACTS), options)
    dtype = wp.float64 if double else wp.float32
    arrays = {name: np.stack([s[name] for s in states]).reshape(count, -1) for name in STATE} | {"contacts": contacts}
    held = {name: wp.array(value.ravel(), dtype=dtype, device="cpu") for name, value in arrays.items()}
    arguments = kernel.arguments()
    for name, value in arrays.items():
        setattr(arguments, name, held[name].ptr or 0)
        setattr(arguments, f"{name}_stride", value[0].size)
    for name, field in PARAMETERS.items():
        value = np.atleast_1d(getattr(model.opt, field[4:]) if field.startswith("opt.") else getattr(model, field))
        held[field] = wp.array(value.astype(float).ravel(), dtype=dtype, device="cpu")
        setattr(arguments, name, held[field].ptr or 0)  # all worlds share it: the stride stays 0
    none = np.zeros(count, dtype=np.int32)
    for name, values in {"nefc": none, "solver_niter": none, "overflow": none, "contact_count": contact_counts}.items():
        held[name] = wp.array(values, dtype=int, device="cpu")
        setattr(arguments, name, held[name].ptr)
    kernel.launch(arguments, count, "cpu")
    found = held["qvel"].numpy().reshape(count, -1)
    error = np.linalg.norm(found - velocities, axis=1) / np.linalg.norm(velocities, axis=1)
    return Comparison(error, held["nefc"].numpy(), rows)


def _numbers(model: mujoco.MjModel, contact: mujoco.MjContact) -> np.ndarray:
    """A contact as constraints.h takes it."""
    bodies = model.geom_bodyid[[contact.geom1, contact.geom2]]
    parts = [contact.dist], contact.pos, contact.frame, contact.friction, contact.solref, contact.solreffriction
    return np.concatenate([*parts, contact.solimp, [contact.includemargin, contact.dim], bodies])
