# SPDX-License-Identifier: Apache-2.0
"""Accelerations of bodies and wrenches of their joints by the fused step: of MuJoCo's C, MuJoCo Warp and statics."""

from __future__ import annotations

import newton
import numpy as np
import pytest

from stripe_newton.solvers import SolverFused
from tests.helpers.fused_step import compare
from tests.helpers.solver_models import (
    MODELS,
    ROOM,
    TREE,
    chain,
    leave_curved_pairs,
    model_of,
    replicated,
    tower_and_ball,
)

FIELDS = ("body_qdd", "body_parent_f")


@pytest.mark.parametrize("name", MODELS)
def test_they_are_those_of_mujoco(name):
    """At the start of the step, with contacts, external wrenches, and in three trees at once."""
    model, given = model_of(name)
    found = compare(model, count=100, given_contacts=given)
    for error in (found.acceleration_error, found.wrench_error):
        assert np.median(error) < 1e-12
        assert np.quantile(error, 0.9) < 1e-9  # in few states the solvers stop at 1e-7 of the forces


@pytest.mark.parametrize("name", [name for name in MODELS if name.startswith("tree")])
def test_in_single_precision(name):
    """Free bodies are left out: their joints carry nothing, so that rounding is all of it."""
    model, given = model_of(name)
    found = compare(model, count=100, double=False, given_contacts=given)
    for error in (found.acceleration_error, found.wrench_error):
        assert np.median(error) < 5e-6
        assert np.quantile(error, 0.99) < 2e-4


def test_of_several_steps_they_are_of_the_last():
    model, _ = model_of("primitives")
    found = compare(model, count=50, steps=3)
    assert np.quantile(found.acceleration_error, 0.99) < 1e-10


@pytest.mark.parametrize("scene", ["chain", "tree", "tower"])
def test_newton_reports_those_of_mujoco_warp(scene, monkeypatch):
    """From the same states in two worlds: in the air, at the ground, and with contacts that others find."""
    leave_curved_pairs(monkeypatch)
    model = {"chain": chain, "tree": lambda n: replicated(TREE, n), "tower": lambda n: tower_and_ball("ellipsoid", n)}[
        scene
    ](2)
    solvers = [kind(model, **ROOM) for kind in (newton.solvers.SolverMuJoCo, SolverFused)]
    reported = [solver.observables(set(FIELDS)) for solver in solvers]
    state, following, control = model.state(), model.state(), model.control()
    state.joint_qd.assign(np.random.default_rng(0).normal(size=model.joint_dof_count))
    errors, sizes = np.zeros((2, 40)), np.zeros((2, 40))
    for i in range(errors.shape[1]):
        solvers[1].step_many(state, following, control, 0.004, 2, observables=reported[1])
        for _ in range(2):
            solvers[0].step(state, state, control, None, 0.004, observables=reported[0])
        for k, name in enumerate(FIELDS):
            expected, found = (getattr(r, name).numpy() for r in reported)
            errors[k, i], sizes[k, i] = np.abs(found - expected).max(), np.abs(expected).max()
    assert sizes.max(axis=1).min() > 10.0 or scene == "tower"
    errors /= np.maximum(sizes, 1.0)  # joints of free bodies carry nothing
    assert np.median(errors, axis=1).max() < 1e-4
    assert errors.max() < 0.1  # impacts: forces of stiff rows in single precision


def test_the_state_has_them_beside_the_observables():
    model = chain(1)
    with pytest.warns(DeprecationWarning, match="request SolverBase.Observables"):
        model.request_state_attributes("body_qdd")
    solver, state = SolverFused(model, **ROOM), model.state()
    observables = solver.observables({"body_qdd"})
    solver.step(state, state, model.control(), None, 0.004, observables=observables)
    fall = observables.body_qdd.numpy()
    assert fall[0, 2] == pytest.approx(-9.81, abs=1e-3)
    np.testing.assert_array_equal(state.body_qdd.numpy(), fall)


def test_a_hanging_chain_carries_its_weight():
    """At rest: no body accelerates, and each joint carries the weight of what hangs below it."""
    link = "<body pos='0 0 -.2'><joint axis='0 1 0'/><geom type='sphere' size='.05' mass='{}'/>{}</body>"
    masses = (1.0, 2.0, 4.0)
    bodies = link.format(masses[0], link.format(masses[1], link.format(masses[2], ""))).replace("-.2", "2", 1)
    model = replicated(bodies, 2)
    solver, state = SolverFused(model, **ROOM), model.state()
    observables = solver.observables(set(FIELDS))
    solver.step_many(state, state, model.control(), 0.004, 10, observables=observables)
    expected = np.zeros((2, 3, 6))
    expected[:, :, 2] = 9.81 * np.cumsum(masses[::-1])[::-1]
    np.testing.assert_allclose(observables.body_parent_f.numpy().reshape(2, 3, 6), expected, atol=1e-4)
    np.testing.assert_allclose(observables.body_qdd.numpy(), 0.0, atol=1e-5)


def test_they_can_be_asked_for_while_running():
    """The kernel is then another one, with the same contacts by others."""
    model, results = tower_and_ball("ellipsoid", 2), []
    for late in (False, True):
        solver, state, control = SolverFused(model, **ROOM), model.state(), model.control()
        observables = None if late else solver.observables(set(FIELDS))
        for _ in range(20):
            solver.step(state, state, control, None, 0.004, observables=observables)
        observables = solver.observables(set(FIELDS))
        solver.step(state, state, control, None, 0.004, observables=observables)
        results.append(observables.body_qdd.numpy())
    assert np.abs(results[0]).max() > 1.0
    np.testing.assert_array_equal(results[1], results[0])
