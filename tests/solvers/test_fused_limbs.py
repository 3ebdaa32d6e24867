# SPDX-License-Identifier: Apache-2.0
"""The form of the fused step for a hub with limbs, against MuJoCo's C in double precision and the general form."""

from __future__ import annotations

import dataclasses

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.solvers import SolverFused, limb_form, step_kernel
from stripe_newton.solvers.contact_pairs import contact_pairs
from stripe_newton.solvers.launch_arguments import ConvertedState, StepCall
from stripe_newton.solvers.limb_form import LimbForm, why_no_limbs
from tests.helpers.fused_step import compare
from tests.helpers.lane_emulator import emulate
from tests.helpers.limb_models import FIELD, GROUND, MESHES, PLANE, POSTS, WALKERS, walker, walker_worlds
from tests.helpers.solver_models import leave_curved_pairs, model_of

STATE = "qpos", "qvel", "qacc_warmstart"


@pytest.mark.parametrize("name", [name for name in WALKERS if name != "many legs"])
def test_a_step_is_that_of_mujoco(name):
    found = compare(walker(name), limbs=True)
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    assert found.rows.max() >= 16
    assert np.median(found.error) < 1e-13
    assert np.quantile(found.error, 0.99) < 1e-10


def test_a_step_among_posts_is_that_of_mujoco(monkeypatch):
    """Capsules, balls and a box that do not move: geoms of limbs come first in some pairs, and second in others."""
    leave_curved_pairs(monkeypatch)  # its cylinder touches the ground alone
    model = walker("floating", replaced=(GROUND, GROUND + POSTS))
    pairs = tuple(contact_pairs(model))
    moves = {(pair.kind, bool(model.body_dofnum[model.body_rootid[model.geom_bodyid[pair.geom2]]])) for pair in pairs}
    assert {("SPHERE_CAPSULE", False), ("SPHERE_CAPSULE", True), ("CAPSULE_BOX", False)} <= moves
    found, on_plane = compare(model, limbs=True), compare(walker("floating"), limbs=True)
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    assert found.rows.sum() > on_plane.rows.sum() + 100
    assert np.median(found.error) < 1e-13
    assert np.quantile(found.error, 0.99) < 1e-9


def test_steps_of_euler_in_single_precision():
    found = compare(walker("floating", "Euler"), double=False, steps=4, limbs=True)
    assert np.mean(found.rows != found.expected_rows) < 0.01
    assert np.median(found.error) < 1e-6
    assert np.quantile(found.error, 0.99) < 1e-4


def test_the_hub_and_the_limbs():
    model = walker("floating")
    form = LimbForm.of(model, tuple(contact_pairs(model)))
    dofs = [list(range(6)), [6], [7], [8, 9], [10, 11, 12], [13, 14, 15]]  # root, two arms, waist, two legs
    assert form.hub_dofs == dofs[0] + dofs[3]
    assert [list(limb) for limb in form.limbs] == [dofs[1], dofs[2], dofs[4], dofs[5]]
    assert sorted(p for share in form.pairs for p in share) == list(range(len(list(contact_pairs(model)))))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("tree, implicitfast", "it has a ball joint"),
        ("primitives", "more than one thing moves"),
    ],
)
def test_what_is_no_hub_with_limbs(name, reason):
    model, _ = model_of(name)
    assert why_no_limbs(model, tuple(contact_pairs(model))) == reason


def test_too_many_limbs():
    model = walker("many legs")
    assert why_no_limbs(model, tuple(contact_pairs(model))) == "it has 11 limbs"


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('contype="2" conaffinity="1"', 'contype="3" conaffinity="3"', "parts of it may touch each other"),
        ('condim="3" friction', 'condim="4" friction', "contacts have torsional or rolling friction"),
        ("range='-.2 .2'", "range='-.2 .2' margin='.3'", "both limits of a joint may act at a time"),
        ("<option", '<option cone="elliptic"', "its friction cones are elliptic"),
    ],
)
def test_what_the_form_has_no_code_for(old, new, reason):
    model = walker("floating", replaced=(old, new))
    assert why_no_limbs(model, tuple(contact_pairs(model))) == reason


def launched(solver: SolverFused, before: dict[str, np.ndarray], steps: int) -> dict[str, np.ndarray]:
    data = solver.mjw_data
    for name, value in before.items():
        getattr(data, name).assign(value)
    solver.fused.launch(solver.launcher.arguments(solver._call), data.nworld, "cpu", steps)
    return {name: getattr(data, name).numpy().copy() for name in (*STATE, "nefc", "qfrc_actuator")}


@pytest.mark.parametrize("ground", [PLANE, FIELD, MESHES], ids=["plane", "field", "meshes"])
def test_worlds_with_parameters_of_their_own(ground, monkeypatch):
    """State, bodies and forces of contacts are those of the general form, and so are states of four lanes.

    Also if these have no room for their touches or searches.
    """
    model = walker_worlds("floating", 12, ground)
    solver = SolverFused(model, njmax=160, nconmax=40, kinematic_switchable_roots=False)
    solver.triangles = solver.static_triangles = True
    rng, data = np.random.default_rng(2), solver.mjw_data
    for name in ("body_mass", "body_inertia", "dof_damping", "geom_friction", "actuator_gainprm"):
        array = getattr(solver.mjw_model, name)
        rows = array.numpy()
        scale = rng.uniform(0.8, 1.2, (12, *[1] * (rows.ndim - 1))).astype(np.float32)
        values = np.broadcast_to(rows, (12, *rows.shape[1:])) * scale
        setattr(solver.mjw_model, name, wp.array(values, dtype=array.dtype, device="cpu"))
    solver.launcher.clear_arguments()
    state, control = model.state(), model.control()
    for _ in range(160):  # until they lie
        control.joint_f.assign(rng.normal(size=model.joint_dof_count).astype(np.float32))
        solver.step(state, state, control, None, 0.005)
    forces = solver.fill_contact_forces()
    before = {name: getattr(data, name).numpy().copy() for name in STATE}
    found = []
    for limbs in (False, True):
        solver.limbs = limbs
        solver.launcher.remake()
        one = launched(solver, before, 3)
        assert solver.fused.layout.is_limbs == limbs
        for name, value in before.items():
            getattr(data, name).assign(value)
        newton_state = model.state()
        solver.step(state, newton_state, control, None, 0.005)
        found.append((one, newton_state, _net_forces(solver, forces)))
    (general, bodies, net), (limb, limb_bodies, limb_net) = found
    assert general["nefc"].sum() > 60
    np.testing.assert_array_equal(general["nefc"], limb["nefc"])
    for name in ("qpos", "qvel", "qfrc_actuator"):
        np.testing.assert_allclose(limb[name], general[name], rtol=2e-4, atol=2e-4)
    for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
        np.testing.assert_allclose(getattr(limb_bodies, name), getattr(bodies, name), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(limb_net, net, rtol=1e-3, atol=0.05)
    assert np.abs(net).max() > 10.0
    emulated = emulate(solver, 4)
    for name, value in before.items():
        getattr(data, name).assign(value)
    emulated(3)
    np.testing.assert_array_equal(data.nefc.numpy(), limb["nefc"])
    np.testing.assert_allclose(data.qvel.numpy(), limb["qvel"], rtol=1e-4, atol=1e-4)
    if ground == PLANE:
        return
    speeds = data.qvel.numpy().copy()
    for name, most in (("_MOST_LISTED", 3), ("_MOST_SEARCHES", 2)):
        with monkeypatch.context() as patch:
            patch.setattr(limb_form, name, most)
            emulated = emulate(solver, 4)
        for name, value in before.items():
            getattr(data, name).assign(value)
        emulated(3)
        np.testing.assert_array_equal(data.qvel.numpy(), speeds)


def test_few_worlds_leave_memory_to_the_cache():
    """Large blocks of few worlds leave no room for a second one, which CUDA would keep memory for; small ones do."""
    large = step_kernel.Layout(0, 0, 497, 0, 32, 1424, True, num_limbs=4, searches_size=1884)
    small = dataclasses.replace(large, world_size=485, searches_size=0)
    found = [dataclasses.replace(o, padding=step_kernel._padding(o, 4)).block_size(4) for o in (large, small)]
    assert 2 * large.block_size(4) < 228 * 1024 < 2 * found[0]
    assert found[0] < 128 * 1024
    assert found[1] == small.block_size(4)
    assert step_kernel.has_few_worlds(4096, 4)
    assert not step_kernel.has_few_worlds(8192, 4)


@pytest.mark.parametrize(("name", "lanes"), [("floating", 4), ("planar", 4), ("planar", 32)])
def test_lanes_read_and_write_newtons_state(name, lanes):
    """Those of a warp copy the rows of all of its worlds, fewer in the last warp, or of one in the general form."""
    worlds, found = 11, []
    model = walker_worlds(name, worlds)
    solver = SolverFused(model, njmax=80, nconmax=20, kinematic_switchable_roots=False)
    solver.limbs = lanes == 4
    rng, control = np.random.default_rng(4), model.control()
    for array in (control.joint_f, control.joint_target_q, control.joint_target_qd):
        array.assign(rng.uniform(-0.3, 0.3, array.shape).astype(np.float32))
    speeds = rng.uniform(-1.0, 1.0, model.joint_dof_count).astype(np.float32)
    observables = solver.observables({solver.ObservableKind.QFRC_ACTUATOR})
    before = wp.zeros(model.joint_dof_count, dtype=float, device="cpu")
    for is_emulated in (False, True):
        state, following = model.state(), model.state()
        state.joint_qd.assign(speeds)
        state.body_f.assign([[0.0, 3.0, 1.0, 0.1, 0.0, 0.0] if b == 5 else [0.0] * 6 for b in range(model.body_count)])
        solver.mjw_data.qacc_warmstart.zero_()
        if is_emulated:
            emulated = emulate(solver, lanes)
            converted = ConvertedState(state, following, control, observables, reads_state=True)
            solver._call = StepCall(3, (None, before), state=converted, dt=0.005)
            emulated(3)
        else:
            solver.step_many(state, following, control, 0.005, 3, observables, (None, before))
        arrays = (following.joint_q, following.joint_qd, following.body_q, following.body_qd, before)
        found.append([a.numpy() for a in (*arrays, observables.qfrc_actuator, solver.mjw_data.qfrc_applied)])
    assert all(np.abs(array).max() > 0.01 for array in found[0])
    for want, have in zip(*found, strict=True):
        np.testing.assert_allclose(have, want, rtol=1e-4, atol=1e-4)


def _net_forces(solver: SolverFused, forces: object) -> np.ndarray:
    """Net force on each geom of each world [N]."""
    geoms, values = forces.geoms.numpy(), forces.forces.numpy()
    net = np.zeros((geoms.shape[0], solver.mj_model.ngeom, 3))
    for world, row in enumerate(geoms):
        for (first, second), force in zip(row, values[world], strict=True):
            if first < 0:
                break
            net[world, second] += force
            net[world, first] -= force
    return net


def test_what_is_asked_for_later_takes_the_general_form(device):
    """With memory for rows that have no place in the state, of which the form for limbs needs none."""
    model = walker_worlds("planar", 8, device=device)
    solver = SolverFused(model, njmax=200, nconmax=40, kinematic_switchable_roots=False)
    state, control = model.state(), model.control()
    solver.step(state, state, control, None, 0.005)
    assert solver.fused.layout.is_limbs
    assert "of a hub with 3 limbs" in solver.describe()
    solver.fill_contacts()
    layout = solver.fused.layout
    assert not layout.is_limbs
    assert device == "cpu" or solver.launcher.buffers.workspace.size >= 8 * layout.spill_size > 0
    solver.step(state, state, control, None, 0.005)
    assert np.isfinite(state.joint_q.numpy()).all()


def test_friction_loss_that_comes_later_is_not_lost():
    """A kernel without a place for it reports that rows did not fit; the next one has it."""
    model = walker_worlds("floating", 2)
    solver = SolverFused(model, njmax=80, nconmax=20, kinematic_switchable_roots=False)
    state = model.state()
    solver.step(state, state, model.control(), None, 0.005)
    assert not solver.mjw_data.overflow.numpy().any()
    model.joint_friction.fill_(0.3)
    solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_PROPERTIES)
    solver.step(state, state, model.control(), None, 0.005)
    assert solver.mjw_data.overflow.numpy().all()
    solver.mjw_data.overflow.zero_()
    solver.notify_buffers_enlarged()
    solver.step(state, state, model.control(), None, 0.005)
    assert not solver.mjw_data.overflow.numpy().any()
    assert solver.mjw_data.nefc.numpy().min() >= 10


def test_overflow_is_told_once():
    """The kernel keeps a step's bits in the observable, those of all steps for itself, and tells new ones."""
    model = walker_worlds("floating", 3)
    solver = SolverFused(model, njmax=80, nconmax=20, kinematic_switchable_roots=False)
    state, observables = model.state(), solver.observables({"overflow"})
    seen, unread = (wp.zeros(1, dtype=wp.int32, device="cpu") for _ in range(2))
    solver.collect_overflow(seen, unread)
    observables.overflow.fill_(8)  # of another step
    solver.step(state, state, model.control(), None, 0.005, observables=observables)
    assert solver.collects_overflow(observables)
    assert not [a for a in (observables.overflow, seen, unread) if a.numpy().any()]
    losses = model.joint_friction.numpy()
    losses[-1] = 0.3  # in the last world, for which the kernel has no place
    model.joint_friction.assign(losses)
    solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_PROPERTIES)
    for is_new in (True, False):
        solver.step(state, state, model.control(), None, 0.005, observables=observables)
        bits = observables.overflow.numpy()
        assert bits.astype(bool).tolist() == [False, False, True]
        assert seen.numpy()[0] == bits[2]
        assert unread.numpy()[0] == (bits[2] if is_new else 0)
        unread.zero_()


def test_a_world_that_is_not_finite_stays_alone():
    model = walker_worlds("floating", 3)
    solver = SolverFused(model, njmax=80, nconmax=20, kinematic_switchable_roots=False)
    state = model.state()
    speeds = state.joint_qd.numpy()
    speeds[model.joint_dof_count // 3 + 8] = np.nan
    state.joint_qd.assign(speeds)
    for _ in range(5):
        solver.step(state, state, model.control(), None, 0.005)
    finite = np.isfinite(state.joint_q.numpy().reshape(3, -1)).all(axis=1)
    assert finite.tolist() == [True, False, True]
