# SPDX-License-Identifier: Apache-2.0
"""The fused step against MuJoCo's C in double precision, and as a Newton solver against MuJoCo Warp."""

from __future__ import annotations

import mujoco
import mujoco_warp
import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.solvers import SolverFused, why_unsupported
from tests.helpers.fused_step import compare
from tests.helpers.robot_files import robot_file
from tests.helpers.solver_models import (
    MODELS,
    ROOM,
    SCENE,
    TREE,
    boxes,
    chain,
    leave_curved_pairs,
    model_of,
    primitives,
    replicated,
    tower_and_ball,
)


@pytest.mark.parametrize("name", MODELS)
def test_a_step_is_that_of_mujoco(name):
    model, given = model_of(name)
    found = compare(model, given_contacts=given)
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    assert found.rows.max() >= 7
    assert np.median(found.error) < 1e-12
    assert np.quantile(found.error, 0.99) < 1e-8
    assert np.median(found.force_error) < 1e-11


@pytest.mark.parametrize("name", MODELS)
def test_a_step_in_single_precision(name):
    model, given = model_of(name)
    found = compare(model, double=False, given_contacts=given)
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    assert np.median(found.error) < 1e-6
    assert np.quantile(found.error, 0.99) < 1e-4


@pytest.mark.parametrize(
    ("bodies", "option", "rest", "reason"),
    [
        (primitives(), 'integrator="RK4"', "", "its integrator is mjINT_RK4"),
        (primitives(), 'solver="CG"', "", "its solver is mjSOL_CG"),
        (primitives(), 'density="1.2"', "", "it has a medium"),
        (
            boxes(),
            "",
            "<actuator><general body='b' dyntype='filter'/></actuator>",
            "acts on neither a joint nor a tendon",
        ),
    ],
)
def test_what_it_does_not_support_is_named(bodies, option, rest, reason):
    bodies = bodies.replace("<body ", '<body name="b" ', 1)
    model = mujoco.MjModel.from_xml_string(SCENE.format(bodies=bodies, option=option, rest=rest))
    assert reason in why_unsupported(model)


@pytest.mark.parametrize("name", ["go1", "g1", "yam", "ant", "humanoid"])
def test_a_step_of_a_robot_of_others(name):
    """On a plane, with the contacts that MuJoCo finds, and under random pushes."""
    spec = mujoco.MjSpec.from_file(str(robot_file(name)))
    if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    model = spec.compile()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    found = compare(model, given_contacts=True)
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    assert np.median(found.error) < 1e-12
    assert np.quantile(found.error, 0.99) < 1e-8


def test_a_newton_solver_with_the_states_of_mujoco_warp():
    """The chain falls and rolls. Masses, frictions and the stiffness of contacts change on the way, by world."""
    flags, model = newton.ModelFlags, chain(3)
    names = "body_mass", "joint_friction", "shape_material_mu", "shape_material_ke"
    built = {name: getattr(model, name).numpy().copy() for name in names}
    states = []
    for kind in (newton.solvers.SolverMuJoCo, SolverFused):
        for name, values in built.items():
            getattr(model, name).assign(values)
        solver = kind(model, **ROOM)
        state, control = model.state(), model.control()
        for step in range(120):
            if step == 60:
                masses, dofs = built["body_mass"], built["joint_friction"]
                model.body_mass.assign(masses * np.repeat([1.0, 2.0, 3.0], len(masses) // 3))
                model.joint_friction.assign(np.where(np.arange(len(dofs)) % 9 > 5, 0.2, dofs))
                model.shape_material_mu.assign(built["shape_material_mu"] * 0.3)
                model.shape_material_ke.assign(built["shape_material_ke"] * 0.2)
                solver.notify_model_changed(
                    flags.BODY_INERTIAL_PROPERTIES | flags.JOINT_DOF_FORCE_PROPERTIES | flags.SHAPE_PROPERTIES
                )
            solver.step(state, state, control, None, 0.004)
        assert solver.mjw_data.nefc.numpy().min() > 3  # friction losses and contacts
        states.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy(), state.body_q.numpy().ravel()]))
    np.testing.assert_allclose(states[1], states[0], atol=2e-4)


@pytest.mark.parametrize(
    ("top", "known", "how", "tolerance"),
    [
        ("box", True, "all physics steps of a step in one launch", 1e-4),
        ("ellipsoid", True, "all physics steps of a step in one launch", 1e-3),
        (
            "ellipsoid",
            False,
            "with MuJoCo Warp's collision detection for ellipsoid and box, plane and ellipsoid, ",
            1e-4,
        ),
    ],
    ids=["a box", "an ellipsoid", "without routines for ellipsoids"],
)
def test_contacts_of_the_kernel_and_of_mujoco_warp(top, known, how, tolerance, monkeypatch):
    """The kernel takes contacts that it has no routine for from MuJoCo Warp."""
    if not known:
        leave_curved_pairs(monkeypatch)
    model, states, forces = tower_and_ball(top, 2), [], []
    for kind in (newton.solvers.SolverMuJoCo, SolverFused):
        solver = kind(model, **ROOM)
        contacts = newton.Contacts(solver.get_max_contact_count(), 0, device="cpu")
        observables = solver.observables({solver.ObservableKind.CONTACT_F}, contacts=contacts)
        state = model.state()
        for _ in range(60):
            solver.step(state, state, model.control(), contacts, 0.004, observables=observables)
        states.append(state.body_q.numpy())
        count = int(contacts.rigid_contact_count.numpy()[0])
        shapes = contacts.rigid_contact_shape0.numpy()[:count], contacts.rigid_contact_shape1.numpy()[:count]
        forces.append(force_on_shapes(shapes, observables.contact_f.numpy()[:count, 2], model.shape_count))
    assert solver.describe().startswith(f"the fused step, {how}")
    np.testing.assert_allclose(states[1], states[0], atol=tolerance)
    assert np.abs(forces[0]).max() > 9.81 * 8.0  # both on the ground
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-3, atol=0.1)


def force_on_shapes(shapes: tuple[np.ndarray, np.ndarray], upward: np.ndarray, count: int) -> np.ndarray:
    """Sums of contact forces on the first shapes of contacts, and of those against them on the second ones."""
    total = np.zeros(count)
    touching = shapes[0] >= 0
    np.add.at(total, shapes[0][touching], upward[touching])
    np.add.at(total, shapes[1][touching], -upward[touching])
    return total


def test_bodies_are_those_of_forward_kinematics():
    model = replicated(TREE, 2)
    solver, state = SolverFused(model, **ROOM), model.state()
    for _ in range(50):
        solver.step(state, state, model.control(), None, 0.004)
    expected = model.state()
    newton.eval_fk(model, state.joint_q, state.joint_qd, expected)
    poses, same = state.body_q.numpy(), expected.body_q.numpy()
    poses[:, 3:] *= np.sign((poses[:, 3:] * same[:, 3:]).sum(1, keepdims=True))  # of two quaternions of a rotation
    assert np.abs(state.joint_qd.numpy()).max() > 1.0
    np.testing.assert_allclose(poses, same, atol=1e-5)
    np.testing.assert_allclose(state.body_qd.numpy(), expected.body_qd.numpy(), atol=1e-4)


def test_several_steps_at_once_are_as_many_steps():
    """With the state before the last of them."""
    model = chain(2)
    solvers = [SolverFused(model, **ROOM) for _ in range(2)]
    states = [model.state() for _ in solvers]
    before = wp.zeros_like(states[0].joint_q), wp.zeros_like(states[0].joint_qd)
    for _ in range(30):
        for step in range(4):
            if step == 3:
                expected = states[0].joint_q.numpy().copy(), states[0].joint_qd.numpy().copy()
            solvers[0].step(states[0], states[0], model.control(), None, 0.004)
        solvers[1].step_many(states[1], states[1], model.control(), 0.004, 4, before=before)
        for array, value in zip(before, expected, strict=True):
            np.testing.assert_allclose(array.numpy(), value, atol=1e-5)
    # Newton's conversion of the free joint between the single steps rounds.
    np.testing.assert_allclose(states[1].joint_q.numpy(), states[0].joint_q.numpy(), atol=1e-4)


@pytest.mark.parametrize(("room", "bit"), [({"njmax": 5}, "NEFC"), ({"nconmax": 2}, "NARROWPHASE")])
def test_what_does_not_fit_is_reported_and_the_rest_stays_finite(room, bit):
    model = chain(2)  # in the air, as Newton makes room for the contacts of the start
    solver = SolverFused(model, **ROOM | room)
    observables = solver.observables({solver.ObservableKind.OVERFLOW})
    state = model.state()
    seen = np.zeros(2, dtype=int)
    for _ in range(100):
        solver.step(state, state, model.control(), None, 0.004, observables=observables)
        seen |= observables.overflow.numpy()
    assert (seen == int(mujoco_warp.OverflowType[bit])).all()
    assert np.isfinite(state.joint_qd.numpy()).all()


def test_what_the_step_does_not_compute_is_refused():
    model = chain(1)
    with pytest.raises(ValueError, match="does not support use_mujoco_cpu=True; use SolverMuJoCo"):
        SolverFused(model, use_mujoco_cpu=True)
    solver = SolverFused(model, **ROOM)
    with pytest.raises(ValueError, match="qfrc_bias"):
        solver.observables({solver.ObservableKind.QFRC_BIAS})
