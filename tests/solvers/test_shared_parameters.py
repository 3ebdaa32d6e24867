# SPDX-License-Identifier: Apache-2.0
"""Shared parameters: one copy is read of what is the same in all worlds, until worlds differ."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.model_tables import PARAMETERS
from stripe_newton.solvers.shared_parameters import parameter_arrays, parameters_of_flags, parameters_of_newton

WORLDS = 3
PENDULUM = """<mujoco><compiler angle="radian"/><option timestep="0.005"/><worldbody>
<body pos="0 0 1"><joint name="hinge" axis="0 1 0" damping="0.1" frictionloss="0.01" range="-2 2"/>
<geom type="capsule" size="0.05" fromto="0 0 0 0.4 0 0"/></body></worldbody></mujoco>"""


@pytest.fixture
def model() -> newton.Model:
    one, all_worlds = newton.ModelBuilder(), newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(one)
    one.add_mjcf(PENDULUM)
    all_worlds.replicate(one, WORLDS)
    return all_worlds.finalize(device="cpu")


def fused(model: newton.Model) -> SolverFused:
    return SolverFused(model, njmax=20, nconmax=5, kinematic_switchable_roots=False)


def velocities(solver: SolverFused, steps: int = 20) -> np.ndarray:
    """Velocities of the worlds after some steps from rest."""
    state = solver.model.state()
    newton.eval_fk(solver.model, state.joint_q, state.joint_qd, state)
    for _ in range(steps):
        solver.step(state, state, solver.model.control(), None, 0.005)
    return state.joint_qd.numpy()


def test_what_all_worlds_have_is_read_once(model):
    model.body_mass.assign([1.0, 2.0, 3.0])
    solver = fused(model)
    velocities(solver, 1)
    assert {"joint_axis", "range", "geom_size", "body_pos", "gravity"} <= solver.launcher.assumptions.shared.names
    assert not {"mass", "weight", "geom_xpos"} & solver.launcher.assumptions.shared.names  # weights follow from masses


def test_worlds_are_compared_again_after_a_notification(model):
    solver = fused(model)
    before = velocities(solver)
    assert not solver.has_stale_graphs
    damping = model.joint_damping.numpy()
    damping[1] = 2.0
    model.joint_damping.assign(damping)
    solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_FORCE_PROPERTIES)
    after = velocities(solver)
    assert solver.has_stale_graphs
    assert after[0] == before[0] == after[2]
    assert abs(after[1]) < 0.7 * abs(before[1])
    # The same as a solver that has never known otherwise.
    np.testing.assert_array_equal(after, velocities(fused(model)))


def test_expected_changes_are_seen_without_a_comparison(model):
    solver = fused(model)
    before = velocities(solver)
    solver.expect_changes(["joint_damping"])
    assert solver.has_stale_graphs
    solver.mjw_model.dof_damping.fill_(0.1)
    wp.copy(solver.mjw_model.dof_damping, wp.array([2.0], dtype=float, device="cpu"), dest_offset=2)
    after = velocities(solver)
    np.testing.assert_array_equal(after[:2], before[:2])
    assert abs(after[2]) < 0.7 * abs(before[2])


def test_changes_that_were_told_are_not_compared(model, monkeypatch):
    solver = fused(model)
    before = velocities(solver)
    solver.expect_changes(["joint_damping"])
    compared = []
    monkeypatch.setattr(solver.launcher.assumptions.shared, "check", lambda parameters: compared.append(parameters))
    model.joint_damping.assign([0.1, 2.0, 0.1])
    with solver.changes_expected():
        solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_FORCE_PROPERTIES)
    assert not compared
    assert abs(velocities(solver)[1]) < 0.7 * abs(before[1])


def test_every_parameter_follows_from_something():
    of_no_model = {name for name, field in PARAMETERS.items() if field.startswith("data.")}
    assert parameters_of_flags(newton.ModelFlags.ALL) == set(PARAMETERS) - of_no_model
    assert parameters_of_newton(["an_array_to_come"]) == parameters_of_flags(newton.ModelFlags.ALL)


@pytest.mark.parametrize(
    "name", ["joint_damping", "joint_armature", "joint_target_ke", "shape_material_mu", "body_mass", "gravity"]
)
def test_what_follows_from_an_array_is_what_its_notification_changes(model, name):
    """Newton's own update is the oracle: what it changes must be among the parameters that are said to follow."""
    from stripe_newton.sim.model_update import model_flags

    solver = fused(model)
    arrays = parameter_arrays(solver)
    before = {n: a.numpy().copy() for n, a in arrays.items()}
    array = getattr(model, name)
    values = array.numpy()
    values[0] = values[0] * 1.5 + 0.25
    array.assign(values)
    solver.notify_model_changed(model_flags([name]))
    changed = {n for n, a in parameter_arrays(solver).items() if not np.array_equal(a.numpy(), before[n])}
    assert changed - {"geom_xpos", "geom_xmat"} <= parameters_of_newton([name])
