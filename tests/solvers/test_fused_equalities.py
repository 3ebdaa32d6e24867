# SPDX-License-Identifier: Apache-2.0
"""Equalities of bodies and joints in the fused step: against MuJoCo's C, MuJoCo Warp, and what they hold together."""

from __future__ import annotations

import mujoco
import mujoco_warp
import newton
import numpy as np
import pytest

from stripe_newton.solvers import SolverFused, why_unsupported
from stripe_newton.solvers.model_tables import ModelTables
from tests.helpers.fused_step import Comparison, State, compare, record
from tests.helpers.solver_models import ROOM

SCENE = """<mujoco><option timestep="0.004" {option}/><worldbody>{bodies}</worldbody>
<equality>{equalities}</equality></mujoco>"""
LINKAGE = """<body name="crank" pos="0 0 1"><joint name="j0" axis="0 1 0" damping=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 .2" size=".02" contype="0" conaffinity="0"/>
<body name="coupler" pos="0 0 .2"><joint name="j1" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .5 0 .1" size=".02" contype="0" conaffinity="0"/></body></body>
<body name="rocker" pos=".6 0 1"><joint name="j2" axis="0 1 0" frictionloss=".01"/>
<geom type="capsule" fromto="0 0 0 -.1 0 .3" size=".02" contype="0" conaffinity="0"/></body>"""
"""A four-bar linkage, which `connect` closes."""
CLOSED = '<connect body1="coupler" body2="rocker" anchor=".5 0 .1"/>'
BLOCKS = """<geom type="plane" size="0 0 1"/>
<body name="a" pos="0 0 .2"><freejoint/><geom type="capsule" size=".05 .1" euler="20 90 0"/></body>
<body name="b" pos=".3 .1 .3"><freejoint/><geom type="capsule" size=".04 .1" euler="0 30 50"/></body>
<body name="c" pos="0 .4 .5" euler="10 20 30"><freejoint/><geom type="sphere" size=".1" pos=".05 0 0"/></body>"""
ARM = """<body name="shoulder" pos="0 0 1"><joint name="j0" type="ball" pos=".02 0 .01" damping=".05"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/><body name="elbow" pos=".3 0 0">
<joint name="j1" axis="0 0 1" damping=".1"/><joint name="j2" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/><site name="tip" pos=".3 .01 0" euler="30 0 10"/></body></body>
<body name="target" mocap="true" pos=".5 .2 1.1" euler="0 10 0"><geom type="sphere" size=".05" contype="0"
conaffinity="0"/><site name="aim" pos="0 0 .05" euler="0 20 0"/></body>
<body name="tool" pos=".7 0 1"><freejoint/><geom type="sphere" size=".05"/><site name="grip" pos="0 .03 0"/></body>"""
MODELS = {
    "linkage": (LINKAGE, CLOSED + '<connect body1="crank" anchor="0 .01 .1" solref="-30 -2"/>', "Euler"),
    "welded": (
        BLOCKS,
        '<weld body1="a" body2="b" torquescale=".3" solref=".03 .8" solimp=".8 .95 .01 .3 3"/>'
        '<weld body1="c" anchor=".1 .2 .3" relpose=".1 .4 .5 .9 .1 .3 .2"/>'
        '<connect body1="b" body2="c" anchor=".1 0 0"/>',
        "implicitfast",
    ),
    "of sites": (
        ARM,
        '<weld site1="tip" site2="grip" torquescale="2"/><connect site1="grip" site2="aim"/>'
        '<weld body1="target" solref=".1 1"/><weld body1="tool" body2="target" torquescale=".05" solref=".1 1"/>',
        "implicitfast",
    ),
    "mixed, elliptic": (
        ARM + BLOCKS,
        '<joint joint1="j1" polycoef=".1"/><weld body1="a" body2="elbow"/><joint joint1="j2" joint2="j1" '
        'polycoef=".1 .5 .2"/><connect body1="tool" body2="shoulder" anchor="0 0 .2"/><joint joint1="j1" joint2="j2"/>',
        'Euler" cone="elliptic',
    ),
}
"""Bodies, equalities and integrator. Bodies that cannot move have no rows."""
SINGLE = {"linkage": (1e-4, 2e-3)}
"""Bounds of the median and the 99th percentile of errors in single precision, where 1e-5 and 3e-4 are missed. Stiff
rows hold light links in a plane: there MuJoCo Warp has 7e-4 in the accelerations and 7e-5 in the velocities, the kernel
6e-5 and 3e-6."""


def model_of(name: str) -> mujoco.MjModel:
    bodies, equalities, option = MODELS[name]
    option = f'integrator="{option}"'
    return mujoco.MjModel.from_xml_string(SCENE.format(bodies=bodies, equalities=equalities, option=option))


def states_of(model: mujoco.MjModel, count: int) -> list[State]:
    """Recorded states, in which some equalities do not act and mocap bodies have been moved."""
    rng, states = np.random.default_rng(1), record(model, count)
    for i, state in enumerate(states):
        state["eq_active"] = (rng.random(model.neq) < 0.7) | (i % 2 == 0)
        if model.nmocap:
            state["mocap_pos"] = model.body("target").pos[None] + 0.05 * rng.normal(size=(1, 3))
            turn = rng.normal(size=4)
            state["mocap_quat"] = turn[None] / np.linalg.norm(turn)
    return states


def check(found: Comparison, median: float, p99: float) -> None:
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    assert len(set(found.rows.tolist())) > 1  # some are not active
    for error in (found.error, found.acceleration_error, found.wrench_error):
        assert np.median(error) < median
        assert np.quantile(error, 0.99) < p99


@pytest.mark.parametrize("name", MODELS)
def test_a_step_is_that_of_mujoco(name):
    """With rows by number and force; they are in the order of the equalities, or forces would be of others."""
    model = model_of(name)
    found = compare(model, states=states_of(model, 200))
    check(found, 1e-12, 1e-8)
    assert np.median(found.force_error) < 1e-12


@pytest.mark.parametrize("name", MODELS)
def test_a_step_in_single_precision(name):
    model = model_of(name)
    found = compare(model, double=False, states=states_of(model, 200))
    check(found, *SINGLE.get(name, (1e-5, 3e-4)))


def linkages(num_worlds: int) -> newton.Model:
    """Worlds with the closed linkage."""
    one, builder = newton.ModelBuilder(), newton.ModelBuilder()
    for made in (one, builder):
        SolverFused.register_custom_attributes(made)
    one.add_mjcf(SCENE.format(bodies=LINKAGE, equalities=CLOSED, option=""))
    builder.replicate(one, num_worlds)
    return builder.finalize(device="cpu")


def gaps(solver: SolverFused, state: newton.State) -> np.ndarray:
    """Distances between the points that the linkages' connections hold together."""
    anchors, bodies = solver.mjw_model.eq_data.numpy()[0, 0, :6].reshape(2, 3), (1, 2)
    poses = state.body_q.numpy().reshape(-1, 3, 7)
    ends = []
    for anchor, body in zip(anchors, bodies, strict=True):
        axis, w = poses[:, body, 3:6], poses[:, body, 6:]
        turned = anchor + 2 * np.cross(axis, np.cross(axis, anchor) + w * anchor)
        ends.append(poses[:, body, :3] + turned)
    return np.linalg.norm(ends[0] - ends[1], axis=1)


def test_equalities_are_switched_by_world():
    """As with MuJoCo Warp, while running; in the second world the linkage opens."""
    flags, model = newton.ModelFlags, linkages(3)
    states, counts = [], []
    for kind in (newton.solvers.SolverMuJoCo, SolverFused):
        model.mujoco.equality_constraint_enabled.fill_(True)
        solver, control = kind(model, **ROOM), model.control()
        state = model.state()
        for step in range(80):
            if step == 40:
                model.mujoco.equality_constraint_enabled.assign([True, False, True])
                solver.notify_model_changed(flags.CONSTRAINT_PROPERTIES)
            solver.step(state, state, control, None, 0.004)
        states.append(state.joint_q.numpy())
        counts.append(solver.mjw_data.nefc.numpy().tolist())
    assert counts == [[4, 1, 4]] * 2
    assert solver.describe().startswith("the fused step")
    gap = gaps(solver, state)
    assert gap[1] > 0.1
    assert max(gap[0], gap[2]) < 1e-4
    # MuJoCo Warp takes the rates of Jacobians of the step before.
    np.testing.assert_allclose(states[1], states[0], atol=5e-3)


def test_a_linkage_stays_closed():
    """Over a minute, swinging and driven, at the steps of a controller."""
    model = linkages(20)
    solver, state, control = SolverFused(model, **ROOM), model.state(), model.control()
    rng, furthest = np.random.default_rng(0), 0.0
    for _ in range(150):
        control.joint_f.assign(0.1 * rng.normal(size=model.joint_dof_count).astype(np.float32))
        solver.step_many(state, state, control, 0.004, 100)
        furthest = max(furthest, gaps(solver, state).max())
    assert np.isfinite(state.joint_q.numpy()).all()
    assert np.abs(state.joint_qd.numpy()).max() > 1.0
    assert furthest < 6e-3  # MuJoCo's C opens by 4e-3 under such forces


def test_a_tool_follows_the_body_that_it_is_welded_to():
    """Newton's bodies without joints are mocap bodies of MuJoCo: whoever moves one, moves what is welded to it."""
    bodies = """<body name="target" pos="0 0 1"><geom type="sphere" size=".02" contype="0" conaffinity="0"/></body>
    <body name="tool" pos="0 0 1"><freejoint/><geom type="box" size=".05 .1 .02"/></body>"""
    one, builder = newton.ModelBuilder(), newton.ModelBuilder()
    for made in (one, builder):
        SolverFused.register_custom_attributes(made)
    weld = '<weld body1="tool" body2="target" relpose="0 0 0 1 0 0 0"/>'
    one.add_mjcf(SCENE.format(bodies=bodies, equalities=weld, option=""))
    builder.replicate(one, 2)
    model = builder.finalize(device="cpu")
    solver, state = SolverFused(model, **ROOM), model.state()
    roots = model.joint_X_p.numpy()
    fixed = (model.joint_type.numpy() == newton.JointType.FIXED) & (model.joint_parent.numpy() < 0)
    roots[fixed] = [[0.2, 0.1, 1.1, 0.0, 0.0, 0.6, 0.8], [-0.1, 0.0, 0.9, 0.6, 0.0, 0.0, 0.8]]
    model.joint_X_p.assign(roots)
    solver.notify_model_changed(newton.ModelFlags.JOINT_PROPERTIES)
    solver.step_many(state, state, model.control(), 0.004, 500)
    assert solver.mjw_data.nefc.numpy().tolist() == [6, 6]
    # Gravity pulls the tool out of the spring of the weld a little.
    np.testing.assert_allclose(state.joint_q.numpy().reshape(2, 7), roots[fixed], atol=2e-3)


def test_rows_without_room_are_refused_or_reported():
    with pytest.raises(ValueError, match="njmax is 5, must be 6 or more"):
        ModelTables.of(model_of("linkage"), 5, 10)
    model = linkages(2)
    model.mujoco.equality_constraint_enabled.fill_(False)
    solver = SolverFused(model, **ROOM | {"njmax": 2})
    model.mujoco.equality_constraint_enabled.assign([False, True])
    solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
    observables, state = solver.observables({solver.ObservableKind.OVERFLOW}), model.state()
    for _ in range(10):
        solver.step(state, state, model.control(), None, 0.004, observables=observables)
    assert observables.overflow.numpy().tolist() == [0, int(mujoco_warp.OverflowType.NEFC)]
    assert np.isfinite(state.joint_qd.numpy()).all()


def test_what_it_does_not_support_is_named():
    tendon = '<tendon><fixed name="t"><joint joint="j0" coef="1"/></fixed></tendon>'
    scene = SCENE.replace("</mujoco>", tendon + "</mujoco>")
    text = scene.format(bodies=LINKAGE, equalities='<tendon tendon1="t"/>', option="")
    assert "is of type mjEQ_TENDON" in why_unsupported(mujoco.MjModel.from_xml_string(text))
    one = newton.ModelBuilder()
    SolverFused.register_custom_attributes(one)
    one.add_mjcf(SCENE.format(bodies=BLOCKS, equalities="", option=""))
    with pytest.raises(ValueError, match="a body is kinematic or may become it"):
        SolverFused(one.finalize(device="cpu"), kinematic_switchable_roots=True)
