# SPDX-License-Identifier: Apache-2.0
"""Contacts with boxes in the fused step, against those of MuJoCo's C: in random poses, at rest and of a robot."""

from __future__ import annotations

import functools
import itertools

import mujoco
import newton
import numpy as np
import pytest

from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.contact_pairs import contact_pairs
from tests.helpers.fused_step import STATE, State, compare

SCENE = """<mujoco><option timestep="0.005" integrator="implicitfast" {option}/>
<worldbody>{bodies}</worldbody><contact>{pairs}</contact></mujoco>"""
BOXES = (0.1, 0.1, 0.1), (0.2, 0.1, 0.03), (0.05, 0.3, 0.12)
OTHERS = {
    "capsule": ((0.05, 0.1), (0.02, 0.3), (0.04, 0.02)),
    "box": ((0.15, 0.1, 0.05), (0.1, 0.1, 0.1), (0.02, 0.2, 0.2)),
}
"""Sizes of what touches the boxes [m]."""
MARGINS = 0.0, 0.01, 0.03
"""Margins of the boxes, and of the others; that of a pair is their sum [m]."""
POSES = "near", "along a face", "along an edge", "inside"
DISTANCE = 2
"""Column of the distance in the contacts of a comparison."""


@functools.cache
def boxes_and(other: str) -> mujoco.MjModel:
    """Three boxes and three others, all free; one of these touches one of those.

    The model names their pairs: of others MuJoCo's broad phase leaves out some that are almost as far as the margin.
    """
    line = "<body><freejoint/><geom name='{}' type='{}' size='{}' contype='0' conaffinity='0'/></body>"
    bodies = [line.format(f"box_{i}", "box", " ".join(map(str, size))) for i, size in enumerate(BOXES)]
    bodies += [line.format(f"other_{i}", other, " ".join(map(str, size))) for i, size in enumerate(OTHERS[other])]
    pair = "<pair geom1='box_{}' geom2='other_{}' margin='{}'/>"
    pairs = [pair.format(i, j, MARGINS[i] + MARGINS[j]) for i in range(3) for j in range(3)]
    return mujoco.MjModel.from_xml_string(SCENE.format(option="", bodies="".join(bodies), pairs="".join(pairs)))


def rotated(vector: np.ndarray, quat: np.ndarray) -> np.ndarray:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, vector, quat)
    return result


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, a, b)
    return result


EVEN_TURNS = np.array([[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5], [0.5, 0.5, 0.5, -0.5]])
"""Rotations that take axes to axes."""


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


def capsule_near(kind: str, box: int, capsule: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation in the frame of a box: an end of the capsule or a point between is near the box."""
    turn, axis = np.zeros(4), direction_of(kind, rng)
    mujoco.mju_quatZ2Vec(turn, axis)
    radius, half_length = OTHERS["capsule"][capsule]
    near = point_near(kind, np.array(BOXES[box]), radius + MARGINS[box] + MARGINS[capsule], rng)
    return near - rng.choice([-1.0, rng.uniform(-1.0, 1.0), 1.0]) * half_length * axis, turn


def box_near(kind: str, box: int, other: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation in the frame of a box: a point of the other one's surface is near the box.

    Face on face they touch to 1e-8 m, in parallel to 1e-8: either face or two edges may be the least deep.
    """
    if kind == "face on face":
        about, side = EVEN_TURNS[rng.integers(3)], rng.integers(3)
        turn = product(about, np.array([1.0, *(10.0 ** -rng.uniform(8.0, 11.0) * rng.normal(size=3))]))
        reach = np.array(BOXES[box]) + np.abs(rotated(np.array(OTHERS["box"][other]), about))
        pos = reach * rng.uniform(-1.0, 1.0, 3)
        pos[side] = reach[side] + rng.choice([-1.0, 1.0]) * 10.0 ** -rng.uniform(8.0, 12.0)
        return pos, turn / np.linalg.norm(turn)
    turn = random_quat(rng)
    if kind.startswith("along"):
        about = EVEN_TURNS[rng.integers(3)]
        if kind == "along an edge":
            turn[1:3] = 0.0
            about = product(about, turn / np.linalg.norm(turn))
        turn = product(about, np.array([1.0, *(10.0 ** -rng.uniform(1.0, 7.0) * rng.normal(size=3))]))
        turn /= np.linalg.norm(turn)
    near = point_near(kind, np.array(BOXES[box]), 0.02 + MARGINS[box] + MARGINS[other], rng)
    return near - rotated(point_near("near", np.array(OTHERS["box"][other]), 0.0, rng), turn), turn


def states_of(kind: str, other: str, count: int, seed: int = 0) -> list[State]:
    """States in which each capsule, or other box, is at a box of its own."""
    model, rng, states = boxes_and(other), np.random.default_rng(seed), []
    data, pose_near = mujoco.MjData(model), {"capsule": capsule_near, "box": box_near}[other]
    for _ in range(count):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(size=model.nv)
        q = data.qpos.reshape(-1, 7)
        for box, index in enumerate(rng.permutation(3)):
            pos, quat = pose_near(kind, box, index, rng)
            turn, place = random_quat(rng), rng.uniform(-0.3, 0.3, 3) + [2.0 * box, 0.0, 0.0]
            q[box] = [*place, *turn]
            q[3 + index] = [*(place + rotated(pos, turn)), *product(turn, quat)]
        states.append({name: getattr(data, name).copy() for name in STATE})
    return states


def counts_of_pairs(contacts: list[np.ndarray]) -> np.ndarray:
    """Contacts of each of the three boxes with each of the others in each state, shape ``(states, 9)``."""
    geoms = (np.sort(c[:, :2], axis=1).astype(int) for c in contacts)
    pairs = (g[:, 0] + 3 * (g[:, 1] - 3) for g in geoms)
    return np.stack([np.bincount(p, minlength=9) for p in pairs])


@pytest.mark.parametrize(("other", "kind"), [*itertools.product(OTHERS, POSES), ("box", "face on face")])
def test_contacts_are_those_of_mujoco(other, kind):
    """Of 3000 pairs in each kind of pose: as many, in the same order, at the same places."""
    found = compare(boxes_and(other), states=states_of(kind, other, 1000))
    counts = counts_of_pairs(found.expected_contacts)
    np.testing.assert_array_equal(counts_of_pairs(found.contacts), counts)
    assert (counts == 1).sum() > 100
    assert (counts == 2).sum() > 10
    if other == "box":
        assert (counts == 4).sum() > 200
        assert (counts > 4).sum() > 20 or kind == "face on face"
    error = np.abs(np.concatenate(found.contacts) - np.concatenate(found.expected_contacts))
    assert np.median(error.max(axis=1)) < 1e-14
    assert error[:, DISTANCE].max() < 1e-10
    # A normal is a difference of points, and edges that are all but parallel cross anywhere: they have fewer digits.
    assert error.max() < 1e-8
    assert np.median(found.error) < 1e-12
    assert np.quantile(found.error, 0.99) < 1e-8


@pytest.mark.parametrize("kind", POSES)
@pytest.mark.parametrize("other", OTHERS)
def test_contacts_in_single_precision(other, kind):
    """Single precision does not tell an angle of 1e-7 from none: some contacts are at another point, or one more."""
    found = compare(boxes_and(other), double=False, states=states_of(kind, other, 500))
    same = (counts_of_pairs(found.contacts) == counts_of_pairs(found.expected_contacts)).all(axis=1)
    pairs = zip(found.contacts, found.expected_contacts, same, strict=True)
    error = np.concatenate([np.abs(c - e).max(axis=1) for c, e, is_same in pairs if is_same])
    assert same.mean() > 0.95
    assert np.median(error) < 1e-6
    assert np.quantile(error, 0.95) < 1e-4
    assert np.median(found.error) < 3e-6


def settled(bodies: str) -> tuple[SolverFused, newton.State]:
    """Bodies after two seconds on a box that stands in the world and is as high as 0.2 m."""
    one = newton.ModelBuilder()
    SolverFused.register_custom_attributes(one)
    one.rigid_gap = 0.0
    one.add_mjcf(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    model = one.finalize(device="cpu")
    solver = SolverFused(model, njmax=100, nconmax=30, kinematic_switchable_roots=False)
    assert solver.describe() == "the fused step, all physics steps of a step in one launch"
    solver.fill_contacts()
    state = model.state()
    solver.step_many(state, state, model.control(), 0.002, 1000)
    assert np.abs(state.joint_qd.numpy()).max() < 1e-3
    return solver, state


def contact_points(solver: SolverFused) -> np.ndarray:
    contact = solver.mjw_data.contact
    return contact.pos.numpy()[contact.geom.numpy()[:, 0] >= 0]


@pytest.mark.parametrize(
    ("half_width", "ends"), [(0.3, 0.15), (0.08, 0.08)], ids=["on its whole length", "across a narrow box"]
)
def test_a_capsule_lies_on_a_box(half_width, ends):
    """On two contacts, at its ends or above the box's edges, which carry its weight."""
    table = f"<body pos='0 0 .1'><geom type='box' size='{half_width} .2 .1'/></body>"
    shape = "type='capsule' size='.05 .15' mass='1' condim='6' friction='1 .1 .05'"
    solver, state = settled(f"{table}<body pos='0 0 .26' euler='0 90 10'><freejoint/><geom {shape}/></body>")
    points = contact_points(solver)
    np.testing.assert_allclose(np.sort(points[:, 0]), [-ends, ends], atol=1e-3)
    np.testing.assert_allclose(points[:, 2], 0.2, atol=1e-3)
    assert state.joint_q.numpy()[2] == pytest.approx(0.25, abs=1e-3)
    assert solver.mjw_data.efc.force.numpy().sum() == pytest.approx(9.81, rel=1e-2)


def test_boxes_stand_on_each_other():
    """Each on the vertices of the area that two faces share: four, or eight where one is turned."""
    body = "<body pos='0 0 {}' euler='0 0 {}'><freejoint/><geom type='box' size='.1 .1 .05' mass='1'/></body>"
    tower = "".join(body.format(z, turn) for z, turn in ((0.251, 10), (0.353, 55), (0.455, 55)))
    solver, state = settled(f"<body pos='0 0 .1'><geom type='box' size='.3 .2 .1'/></body>{tower}")
    heights = contact_points(solver)[:, 2]
    for height, count in ((0.2, 4), (0.3, 8), (0.4, 4)):
        assert (np.abs(heights - height) < 2e-3).sum() == count
    np.testing.assert_allclose(state.joint_q.numpy().reshape(3, 7)[:, 2], [0.25, 0.35, 0.45], atol=2e-3)
    assert solver.mjw_data.efc.force.numpy().sum() == pytest.approx(9.81 * (3 + 2 + 1), rel=1e-2)


ROBOT = """<geom type='plane' size='0 0 1'/><geom type='box' size='.1 .4 .1' pos='.25 0 0' euler='0 20 10'/>
<geom type='box' size='.08 .08 .15' pos='-.2 .1 0'/><geom type='box' size='.3 .05 .06' pos='0 -.15 0' euler='0 0 30'/>
<body pos='0 0 .4'><freejoint/><geom type='capsule' fromto='-.2 0 0 .2 0 0' size='.05'/>{legs}</body>
<body pos='.02 .2 .2'><freejoint/><geom type='box' size='.1 .08 .06' density='300' margin='.01'/></body>
<body pos='0 -.15 .2' euler='70 20 0'><freejoint/><geom type='box' size='.05 .05 .12' density='300'/></body>"""
LEG = """<body pos='{x} {y} 0'><joint axis='0 1 0' damping='.1' armature='.005'/>
<geom type='capsule' fromto='0 0 0 0 {y} -.15' size='.03'/><body pos='0 {y} -.15'>
<joint axis='0 1 0' range='-1.5 1.5' limited='true' damping='.1' armature='.005'/>
<geom type='capsule' fromto='0 0 0 .05 0 -.15' size='.02' condim='{dim}' margin='.005'/></body></body>"""


@pytest.mark.parametrize(
    ("option", "double"), [("", True), ('cone="elliptic" impratio="3"', False)], ids=["double", "elliptic, single"]
)
def test_a_robot_among_boxes(option, double):
    """Four legs on a trunk, on the ground among boxes, of which two are free, kicked at random."""
    legs = "".join(LEG.format(x=x, y=y, dim=4 if x > 0 else 6) for x in (-0.2, 0.2) for y in (-0.06, 0.06))
    model = mujoco.MjModel.from_xml_string(SCENE.format(option=option, bodies=ROBOT.format(legs=legs), pairs=""))
    assert all(pair.kind for pair in contact_pairs(model))
    found = compare(model, count=300, double=double)
    np.testing.assert_array_equal(found.rows, found.expected_rows)
    types = np.sort(model.geom_type[np.concatenate(found.expected_contacts)[:, :2].astype(int)], axis=1)
    box = mujoco.mjtGeom.mjGEOM_BOX
    for other in (mujoco.mjtGeom.mjGEOM_CAPSULE, box):
        assert (types == [other, box]).all(axis=1).sum() > 100
    median, p99 = (1e-12, 1e-8) if double else (1e-6, 1e-4)
    assert np.median(found.error) < median
    assert np.quantile(found.error, 0.99) < p99
    assert np.median(found.force_error) < (1e-11 if double else 1e-5)
