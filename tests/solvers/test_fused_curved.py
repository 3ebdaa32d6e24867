# SPDX-License-Identifier: Apache-2.0
"""Contacts of cylinders and ellipsoids in the fused step, against those of MuJoCo's C."""

from __future__ import annotations

import functools

import mujoco
import newton
import numpy as np
import pytest

from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.contact_pairs import contact_pairs
from tests.helpers.fused_step import STATE, Comparison, State, compare
from tests.helpers.lane_emulator import emulate, rows_by_thread_and_lanes

PLACE = slice(2, 9)
"""Columns of distance, point and normal in the contacts of a comparison."""
SHAPES = {
    "plane": "type='plane' size='0 0 1'",
    "ball": "type='sphere' size='.08'",
    "rod": "type='capsule' size='.04 .15'",
    "egg": "type='ellipsoid' size='.1 .15 .2'",
    "pebble": "type='ellipsoid' size='.2 .1 .1'",
    "can": "type='cylinder' size='.1 .15'",
    "disc": "type='cylinder' size='.15 .05'",
    "box": "type='box' size='.08 .12 .16'",
    "block": "type='mesh' mesh='block'",
    "stone": "type='mesh' mesh='stone'",
}
POINTS = {
    "block": np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05)]),
    "stone": np.random.default_rng(1).normal(size=(25, 3)),
}
POINTS["stone"] *= 0.1 / np.linalg.norm(POINTS["stone"], axis=1, keepdims=True) * (1.0, 0.5, 2.0)
MESHES = "".join(
    f"<mesh name='{name}' vertex='{' '.join(f'{x:.6f}' for x in points.ravel())}'/>" for name, points in POINTS.items()
)
PAIRS = (
    ("plane", "egg"), ("ball", "egg"), ("ball", "can"), ("rod", "egg"), ("rod", "can"), ("egg", "pebble"),
    ("egg", "can"), ("egg", "box"), ("can", "disc"), ("can", "box"), ("rod", "block"), ("rod", "stone"),
    ("egg", "stone"), ("can", "block"), ("can", "stone"),
)  # fmt: skip
SEVERAL = [("rod", "can"), ("can", "disc"), ("can", "box"), *PAIRS[10:12], *PAIRS[13:]]
"""Pairs of which faces or edges lie on each other: of several corners or faces MuJoCo sometimes takes others."""
FLAT = np.sqrt([[1.0, 0.0, 0.0, 0.0], [0.25, 0.25, 0.25, 0.25], [0.5, 0.5, 0.0, 0.0], [0.5, 0.0, 0.5, 0.0]])
"""Turns that take axes to axes."""


@functools.cache
def scene(margin: float = 0.0) -> mujoco.MjModel:
    """A plane and bodies, of which the pairs may touch. MuJoCo's expanding polytope goes on until rounding ends it."""
    line = "<body><freejoint/><geom name='{}' {} contype='0' conaffinity='0'/></body>"
    bodies = "".join(line.format(name, shape) for name, shape in SHAPES.items() if name != "plane")
    pairs = "".join(f"<pair geom1='{a}' geom2='{b}' margin='{margin}'/>" for a, b in PAIRS)
    return mujoco.MjModel.from_xml_string(
        "<mujoco><option timestep='0.005' integrator='implicitfast' ccd_tolerance='1e-14' ccd_iterations='200'/>"
        f"<asset>{MESHES}</asset><worldbody>"
        f"<geom name='plane' {SHAPES['plane']} contype='0' conaffinity='0'/>{bodies}</worldbody>"
        f"<contact>{pairs}</contact></mujoco>"
    )


def states_of(pair: tuple[str, str], kind: str, count: int, margin: float = 0.0) -> list[State]:
    """States in which a pair overlaps by up to 3 cm beyond its margin; ``"flat"``: all but along each other's axes."""
    model, rng, states = scene(margin), np.random.default_rng(0), []
    data, names = mujoco.MjData(model), list(SHAPES)
    geoms = [names.index(name) for name in pair]
    while len(states) < count:
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(size=model.nv)
        q = data.qpos.reshape(-1, 7)
        q[:, :3] = [[3.0 * (i + 1), 0.0, 5.0] for i in range(len(q))]
        for geom in geoms:
            turn = rng.normal(size=4)
            if kind == "flat":
                turn = FLAT[rng.integers(4)] + 10.0 ** -rng.uniform(0.5, 4.0) * turn
            q[geom - 1, 3:] = turn / np.linalg.norm(turn)
        way = rng.normal(size=3) * (np.where(np.arange(3) == rng.integers(3), 1.0, 0.3) if kind == "flat" else 1.0)
        place = np.zeros(3) if pair[0] == "plane" else q[geoms[0] - 1, :3] + [0.0, 0.0, 3.0]
        way = np.array([0.0, 0.0, 1.0]) if pair[0] == "plane" else way / np.linalg.norm(way)
        if pair[0] != "plane":
            q[geoms[0] - 1, :3] = place
        apart, depth = 0.6, rng.uniform(0.0, 0.03) - margin
        for _ in range(40):  # along a line, until the distance is what was drawn
            q[geoms[1] - 1, :3] = place + apart * way
            mujoco.mj_kinematics(model, data)
            apart -= 0.8 * (mujoco.mj_geomDistance(model, data, *geoms, 2.0, None) + depth)
        mujoco.mj_forward(model, data)
        if data.ncon or rng.random() < 0.1:
            states.append({name: getattr(data, name).copy() for name in STATE})
    return states


def differences(found: Comparison) -> np.ndarray:
    """Largest difference of the contacts of each state, infinite where MuJoCo has others."""
    result = []
    for own, other in zip(found.contacts, found.expected_contacts, strict=True):
        apart = np.abs(own[:, None, PLACE] - other[None, :, PLACE]).max(axis=2)
        far = max(apart.min(axis=0).max(), apart.min(axis=1).max()) if apart.size else 0.0
        result.append(far if len(own) == len(other) else np.inf)
    return np.array(result)


@pytest.mark.parametrize("kind", ["any", "flat"])
@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_contacts_are_those_of_mujoco(pair, kind):
    margin = 0.01 if kind == "any" and pair[1] != "box" else 0.0
    found = compare(scene(margin), states=states_of(pair, kind, 150, margin))
    counts = np.bincount([len(contacts) for contacts in found.contacts], minlength=5)
    assert counts[2] > 10 or kind == "any" or pair not in [("rod", "can"), ("can", "disc"), ("can", "box")]
    assert counts[4] > 5 or kind == "any" or pair not in [("can", "disc"), ("can", "box")]
    error = differences(found)
    # Where bodies are round, a normal is found to the root of a distance.
    assert np.median(error) < 2e-6
    assert np.mean(error < 2e-4) > (0.7 if pair in SEVERAL else 0.97)
    depths = np.array([[-c[:, 2].min(initial=0.0) for c in cs] for cs in (found.contacts, found.expected_contacts)])
    assert np.mean(np.abs(depths[0] - depths[1]) < 2e-3) > 0.88
    assert np.median(found.error) < 2e-6


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_contacts_in_single_precision(pair):
    found = compare(scene(), double=False, states=states_of(pair, "any", 150))
    error = differences(found)
    assert np.median(error) < 5e-4
    assert np.mean(error < 1e-2) > (0.7 if pair in SEVERAL else 0.95)
    assert np.median(found.error) < 5e-4


@pytest.mark.parametrize("place", [np.nan, np.inf, 1e30])
def test_a_body_that_flew_away_touches_nothing(place):
    states = states_of(("can", "box"), "any", 3) + states_of(("egg", "pebble"), "any", 3)
    for state in states:
        state["qpos"].reshape(-1, 7)[[2, 4], 2] = place  # the egg and the can
    assert not any(map(len, compare(scene(), states=states, double=False).contacts))


def pile(worlds: int) -> SolverFused:
    """A solver of worlds in which cans and a pebble fall on a slab, a mesh, that lies on the ground."""
    one = newton.ModelBuilder()
    SolverFused.register_custom_attributes(one)
    one.rigid_gap = 0.0
    body = "<body pos='{} 0 {}' euler='{} {} 0'><freejoint/><geom {} density='500' {}/></body>"
    corners = " ".join(f"{x} {y} {z}" for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.1, 0.1))
    shapes = "type='mesh' mesh='slab'", SHAPES["can"], SHAPES["disc"], "type='ellipsoid' size='.1 .1 .05'"
    rolling = "condim='6' friction='1 .01 .01'"
    bodies = "".join(body.format(0.01 * i, 0.1 + 0.26 * i, 0, 4 * i, s, rolling) for i, s in enumerate(shapes))
    slab = f"<asset><mesh name='slab' vertex='{corners}'/></asset>"
    one.add_mjcf(f"<mujoco>{slab}<worldbody><geom {SHAPES['plane']} {rolling}/>{bodies}</worldbody></mujoco>")
    builder = newton.ModelBuilder()
    SolverFused.register_custom_attributes(builder)
    builder.replicate(one, worlds)
    model = builder.finalize(device="cpu")
    rng, q = np.random.default_rng(0), model.joint_q.numpy().reshape(worlds, 4, 7)
    q[:, :, :2] += rng.uniform(-0.02, 0.02, (worlds, 4, 2))
    model.joint_q.assign(q.ravel())
    return SolverFused(model, njmax=200, nconmax=30, kinematic_switchable_roots=False)


def test_a_pile_comes_to_rest_by_a_thread_and_by_lanes_alike():
    """Upright on each other, in one launch. On the way lanes find what a thread finds."""
    solver = pile(6)
    assert solver.describe() == "the fused step, all physics steps of a step in one launch"
    lanes, rows, state = emulate(solver, 32), 0, solver.model.state()
    for turn in range(20):
        solver.step_many(state, state, solver.model.control(), 0.004, 50)
        rows += rows_by_thread_and_lanes(solver, lanes) if turn % 5 == 0 else 0
    assert rows > 200
    heights = state.joint_q.numpy().reshape(6, 4, 7)[:, :, 2]
    np.testing.assert_allclose(heights, np.tile([0.1, 0.35, 0.55, 0.65], (6, 1)), atol=0.01)
    assert np.abs(state.joint_qd.numpy()).max() < 0.1


def test_all_pairs_of_primitives_are_found():
    kinds = {mujoco.mjtGeom(g) for g in (0, 2, 3, 4, 5, 6)}
    names = {mujoco.mjtGeom(g): str(mujoco.mjtGeom(g).name).removeprefix("mjGEOM_").lower() for g in kinds}
    geoms = "".join(
        f"<body pos='{i} 0 3'><freejoint/><geom type='{name}' size='.1 .1 .1'/></body>" * 2
        for i, name in enumerate(sorted(set(names.values()) - {"plane"}))
    )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><geom type='plane' size='0 0 1'/>{geoms}</worldbody></mujoco>"
    )
    found = [pair.kind for pair in contact_pairs(model)]
    assert len(found) == 10 + 45
    assert all(found)
