# SPDX-License-Identifier: Apache-2.0
"""Contacts with boxes in the fused step, against those of MuJoCo's C: in random poses, at rest and of a robot."""

from __future__ import annotations

import functools

import mujoco
import newton
import numpy as np
import pytest

from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.model_tables import contact_pairs
from tests.helpers.fused_step import STATE, State, compare

SCENE = (
    """<mujoco><option timestep="0.002" integrator="implicitfast" {option}/><worldbody>{bodies}</worldbody></mujoco>"""
)
BOXES = (0.1, 0.1, 0.1), (0.2, 0.1, 0.03), (0.05, 0.3, 0.12)
"""Half sizes [m]."""
CAPSULES = (0.05, 0.1), (0.02, 0.3), (0.04, 0.02)
"""Radii and half lengths [m]."""
MARGINS = 0.0, 0.01, 0.03
"""Margins of the boxes and of the capsules; that of a pair is their sum [m]."""
POSES = "near", "along a face", "along an edge", "inside"
DISTANCE = 2
"""Column of the distance in the contacts of a comparison."""


def free_bodies(kind: str, sizes: tuple[tuple[float, ...], ...], collides: str) -> str:
    """Free bodies of one shape, with all margins."""
    line = "<body><freejoint/><geom type='{}' size='{}' margin='{}' {}/></body>"
    lines = (line.format(kind, " ".join(map(str, s)), m, collides) for s, m in zip(sizes, MARGINS, strict=True))
    return "".join(lines)


@functools.cache
def capsules_and_boxes() -> mujoco.MjModel:
    """Three boxes and three capsules; only a box and a capsule touch."""
    boxes = free_bodies("box", BOXES, "contype='0' conaffinity='1'")
    capsules = free_bodies("capsule", CAPSULES, "contype='1' conaffinity='0'")
    return mujoco.MjModel.from_xml_string(SCENE.format(option="", bodies=boxes + capsules))


def rotated(vector: np.ndarray, quat: np.ndarray) -> np.ndarray:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, vector, quat)
    return result


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, a, b)
    return result


def random_quat(rng: np.random.Generator) -> np.ndarray:
    quat = rng.normal(size=4)
    return quat / np.linalg.norm(quat)


def point_near(kind: str, size: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
    """Point in the frame of a box: inside it, or at a face, an edge or a corner, within reach and a bit beyond it."""
    point = size * rng.uniform(-1.0, 1.0, 3)
    if kind != "inside":
        sides = rng.permutation(3)[: rng.integers(1, 4)]
        out = np.zeros(3)
        out[sides] = rng.choice([-1.0, 1.0], len(sides)) * rng.uniform(0.1, 1.0, len(sides))
        point[sides] = (size * np.sign(out))[sides]
        point += rng.uniform(-0.3, 1.2) * reach * out / np.linalg.norm(out)
    return point


def direction_of(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Direction of a capsule in the frame of a box: any, or parallel to a face or an edge up to 1e-7 to 0.1."""
    axis, small = rng.normal(size=3), 10.0 ** -rng.uniform(1.0, 7.0)
    if kind == "along a face":
        axis[rng.integers(3)] *= small
    if kind == "along an edge":
        axis[np.arange(3) != rng.integers(3)] *= small
    return axis / np.linalg.norm(axis)


def states_of(kind: str, count: int, seed: int = 0) -> list[State]:
    """States in which each capsule is at a box of its own: one of its ends or a point between is near the box."""
    model, rng, states = capsules_and_boxes(), np.random.default_rng(seed), []
    data = mujoco.MjData(model)
    for _ in range(count):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(size=model.nv)
        q = data.qpos.reshape(-1, 7)
        for box, capsule in enumerate(rng.permutation(3)):
            turn, turn_of_axis, axis = random_quat(rng), np.zeros(4), direction_of(kind, rng)
            mujoco.mju_quatZ2Vec(turn_of_axis, axis)
            radius, half_length = CAPSULES[capsule]
            near = point_near(kind, np.array(BOXES[box]), radius + MARGINS[box] + MARGINS[capsule], rng)
            center = near - rng.choice([-1.0, rng.uniform(-1.0, 1.0), 1.0]) * half_length * axis
            place = rng.uniform(-0.3, 0.3, 3) + [2.0 * box, 0.0, 0.0]
            q[box] = [*place, *turn]
            q[3 + capsule] = [*(place + rotated(center, turn)), *product(turn, turn_of_axis)]
        states.append({name: getattr(data, name).copy() for name in STATE})
    return states


def counts_of_pairs(contacts: list[np.ndarray]) -> np.ndarray:
    """Contacts of each pair of a box and a capsule in each state, shape ``(states, 9)``."""
    pairs = ((3 * (c[:, 0] - 3) + c[:, 1]).astype(int) for c in contacts)
    return np.stack([np.bincount(p, minlength=9) for p in pairs])


@pytest.mark.parametrize("kind", POSES)
def test_contacts_are_those_of_mujoco(kind):
    """Of 3000 pairs in each kind of pose: as many, in the same order, at the same places."""
    found = compare(capsules_and_boxes(), states=states_of(kind, 1000))
    counts = counts_of_pairs(found.expected_contacts)
    np.testing.assert_array_equal(counts_of_pairs(found.contacts), counts)
    assert (counts == 1).sum() > 500
    assert (counts == 2).sum() > 50
    error = np.abs(np.concatenate(found.contacts) - np.concatenate(found.expected_contacts))
    assert np.median(error.max(axis=1)) < 1e-14
    assert error[:, DISTANCE].max() < 1e-11
    # Normals are differences of points: a box 1e-4 m from the axis of a capsule leaves them four digits less.
    assert error.max() < 1e-8
    assert np.median(found.error) < 1e-12
    assert np.quantile(found.error, 0.99) < 1e-8


@pytest.mark.parametrize("kind", POSES)
def test_contacts_in_single_precision(kind):
    """Single precision does not tell an angle of 1e-7 from none: few contacts begin or end at another point."""
    found = compare(capsules_and_boxes(), double=False, states=states_of(kind, 500))
    same = (counts_of_pairs(found.contacts) == counts_of_pairs(found.expected_contacts)).all(axis=1)
    assert same.mean() > 0.97
    pairs = zip(found.contacts, found.expected_contacts, same, strict=True)
    error = np.concatenate([np.abs(c - e).max(axis=1) for c, e, is_same in pairs if is_same])
    assert np.median(error) < 1e-6
    assert np.quantile(error, 0.95) < 1e-4
    assert np.median(found.error) < 3e-6


def capsule_on_box(half_width: float) -> tuple[SolverFused, newton.State]:
    """A capsule of radius 0.05 and half length 0.15 m, two seconds after it was dropped on a box as high as 0.2 m."""
    one = newton.ModelBuilder()
    SolverFused.register_custom_attributes(one)
    one.rigid_gap = 0.0
    one.add_mjcf(
        f"""<mujoco><worldbody><body pos='0 0 .1'><geom type='box' size='{half_width} .2 .1'/></body>
        <body pos='0 0 .26' euler='0 90 10'><freejoint/><geom type='capsule' size='.05 .15' mass='1' condim='6'
        friction='1 .1 .05'/></body></worldbody></mujoco>"""
    )
    model = one.finalize(device="cpu")
    solver = SolverFused(model, njmax=40, nconmax=10, kinematic_switchable_roots=False)
    solver.fill_contacts()
    state = model.state()
    solver.step_many(state, state, model.control(), 0.002, 1000)
    return solver, state


@pytest.mark.parametrize(
    ("half_width", "ends"), [(0.3, 0.15), (0.08, 0.08)], ids=["on its whole length", "across a narrow box"]
)
def test_a_capsule_lies_on_a_box(half_width, ends):
    """On two contacts, at its ends or above the box's edges, which carry its weight."""
    solver, state = capsule_on_box(half_width)
    assert solver.describe() == "the fused step, all physics steps of a step in one launch"
    contact = solver.mjw_data.contact
    points = contact.pos.numpy()[contact.geom.numpy()[:, 0] >= 0]
    np.testing.assert_allclose(np.sort(points[:, 0]), [-ends, ends], atol=1e-3)
    np.testing.assert_allclose(points[:, 2], 0.2, atol=1e-3)
    assert state.joint_q.numpy()[2] == pytest.approx(0.25, abs=1e-3)
    assert np.abs(state.joint_qd.numpy()).max() < 1e-3
    assert solver.mjw_data.efc.force.numpy().sum() == pytest.approx(9.81, rel=1e-2)


ROBOT = """<geom type='plane' size='0 0 1'/><geom type='box' size='.1 .4 .1' pos='.25 0 0' euler='0 20 10'/>
<geom type='box' size='.08 .08 .15' pos='-.2 .1 0'/><geom type='box' size='.3 .05 .06' pos='0 -.15 0' euler='0 0 30'/>
<body pos='0 0 .4'><freejoint/><geom type='capsule' fromto='-.2 0 0 .2 0 0' size='.05'/>{legs}</body>"""
LEG = """<body pos='{x} {y} 0'><joint axis='0 1 0' damping='.1' armature='.005'/>
<geom type='capsule' fromto='0 0 0 0 {y} -.15' size='.03'/><body pos='0 {y} -.15'>
<joint axis='0 1 0' range='-1.5 1.5' limited='true' damping='.1' armature='.005'/>
<geom type='capsule' fromto='0 0 0 .05 0 -.15' size='.02' condim='{dim}' margin='.005'/></body></body>"""


@pytest.mark.parametrize("double", [True, False], ids=["double", "single"])
@pytest.mark.parametrize("option", ["", 'cone="elliptic" impratio="3"'], ids=["pyramidal", "elliptic"])
def test_a_robot_of_capsules_among_boxes(option, double):
    """Four legs on a trunk, on the ground among three boxes, kicked at random."""
    legs = "".join(LEG.format(x=x, y=y, dim=4 if x > 0 else 6) for x in (-0.2, 0.2) for y in (-0.06, 0.06))
    model = mujoco.MjModel.from_xml_string(SCENE.format(option=option, bodies=ROBOT.format(legs=legs)))
    assert all(pair.kind for pair in contact_pairs(model))
    found = compare(model, count=300, double=double)
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    types = np.sort(model.geom_type[np.concatenate(found.expected_contacts)[:, :2].astype(int)], axis=1)
    touches = (types == [mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX]).all(axis=1)
    assert touches.sum() > 200
    median, p99 = (1e-12, 1e-8) if double else (1e-6, 1e-4)
    assert np.median(found.error) < median
    assert np.quantile(found.error, 0.99) < p99
    assert np.median(found.force_error) < (1e-11 if double else 1e-5)
