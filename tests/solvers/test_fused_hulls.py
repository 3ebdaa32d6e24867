# SPDX-License-Identifier: Apache-2.0
"""Contacts of hulls in the fused step, with planes, balls, boxes and each other, against those of MuJoCo's C."""

from __future__ import annotations

import functools

import mujoco
import newton
import numpy as np
import pytest

from stripe_newton.solvers import SolverFused, pair_division
from stripe_newton.solvers.contact_pairs import contact_pairs
from stripe_newton.solvers.hulls import Hull, sides_of_pairs
from tests.helpers.fused_step import STATE, Comparison, State, compare
from tests.helpers.lane_emulator import emulate, rows_by_thread_and_lanes

PLACE = slice(2, 9)
"""Columns of distance, point and normal in the contacts of a comparison."""
ROUNDING = 1e-7
"""MuJoCo's expanding polytope ends where it gains no more than this."""


def points_of(name: str) -> np.ndarray:
    """Vertices of a mesh [m]."""
    if name == "block":
        return np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05)])
    if name == "prism":
        turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
        return np.array([[0.1 * np.cos(t), 0.1 * np.sin(t), z] for t in turns for z in (-0.1, 0.1)])
    points = np.random.default_rng(1).normal(size=(25, 3))
    return 0.1 * points / np.linalg.norm(points, axis=1, keepdims=True) * (1.0, 0.5, 2.0)


MESHES = ("block", "prism", "stone")
PAIRS = {
    "plane": [("plane", name) for name in MESHES],
    "ball": [("ball", name) for name in MESHES],
    "box": [("box", name) for name in MESHES],
    "hull": [("block", "prism"), ("prism", "stone"), ("stone", "block")],
}
POSES = "any", "flat"


@functools.cache
def scene(margin: float = 0.0) -> mujoco.MjModel:
    """A plane and five free bodies, of which the pairs may touch. Those with plane and ball have a margin."""
    meshes = [f"<mesh name='{n}' vertex='{' '.join(f'{x:.6f}' for x in points_of(n).ravel())}'/>" for n in MESHES]
    line = "<body><freejoint/><geom name='{}' {} contype='0' conaffinity='0'/></body>"
    bodies = [line.format("box", "type='box' size='.08 .1 .05'"), line.format("ball", "type='sphere' size='.06'")]
    bodies += [line.format(n, f"type='mesh' mesh='{n}'") for n in MESHES]
    plane = "<geom name='plane' type='plane' size='0 0 1' contype='0' conaffinity='0'/>"
    named = [(a, b, 0.01 if kind in ("plane", "ball") else margin) for kind, pairs in PAIRS.items() for a, b in pairs]
    pairs = [f"<pair geom1='{a}' geom2='{b}' margin='{m}'/>" for a, b, m in named]
    return mujoco.MjModel.from_xml_string(
        "<mujoco><option timestep='0.005' integrator='implicitfast'/>"
        f"<asset>{''.join(meshes)}</asset><worldbody>{plane}{''.join(bodies)}</worldbody>"
        f"<contact>{''.join(pairs)}</contact></mujoco>"
    )


def states_of(second: str, kind: str, count: int) -> list[State]:
    """States in which one pair touches; ``"flat"``: all but along each other's axes."""
    model, rng, states = scene(), np.random.default_rng(0), []
    data, turns = mujoco.MjData(model), np.array([[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5]])
    bodies = {name: i for i, name in enumerate(("box", "ball", *MESHES))}
    while len(states) < count:
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(size=model.nv)
        q = data.qpos.reshape(-1, 7)
        q[:, :3] = [[2.0 * i, 0.0, 5.0] for i in range(5)]
        pair = PAIRS[second][len(states) % 3]
        for name in set(pair) - {"plane"}:
            q[bodies[name], :3] = rng.uniform(-0.12, 0.12, 3) + (0.0, 0.0, 0.0 if second == "plane" else 9.0)
            small = 10.0 ** -rng.uniform(0.5, 6.0)
            turn = rng.normal(size=4) if kind == "any" else turns[rng.integers(2)] + small * rng.normal(size=4)
            q[bodies[name], 3:] = turn / np.linalg.norm(turn)
        mujoco.mj_forward(model, data)
        if data.ncon or rng.random() < 0.1:
            states.append({name: getattr(data, name).copy() for name in STATE})
    return states


def differences(found: Comparison) -> np.ndarray:
    """Largest difference of the contacts of each state, infinite where MuJoCo has others.

    Of an edge of which one end is above a face MuJoCo counts the other one twice.
    """
    result = []
    for own, other in zip(found.contacts, found.expected_contacts, strict=True):
        other = other[np.unique(np.round(other[:, PLACE], 9), axis=0, return_index=True)[1]]
        apart = np.abs(own[:, None, PLACE] - other[None, :, PLACE]).max(axis=2)
        same = len(own) == len(other) and (not len(own) or len(set(apart.argmin(axis=1))) == len(own))
        result.append(
            apart.min(axis=1, initial=np.inf).max(initial=0.0) if same and len(own) else 0.0 if same else np.inf
        )
    return np.array(result)


@pytest.mark.parametrize("kind", POSES)
@pytest.mark.parametrize("second", PAIRS)
def test_contacts_are_those_of_mujoco(second, kind):
    """In nearly all states all contacts are; of two hulls MuJoCo sometimes ends in a face that is not the nearest."""
    found = compare(scene(), states=states_of(second, kind, 450))
    counts = np.bincount([len(contacts) for contacts in found.contacts], minlength=5)
    assert counts[1:].min() >= 2 or second == "ball"
    assert counts[4] > 25 or kind == "any" or second == "ball"
    error = differences(found)
    assert np.median(error) < (1e-12 if second == "ball" else 1e-14)
    # MuJoCo ends for a ball whose centre is inside where it gains no more than 1e-6: points err by its square root.
    assert np.mean(error < (5e-4 if second == "ball" else ROUNDING)) > (0.999 if second == "plane" else 0.97)
    assert np.median(found.error) < 1e-12
    # The normals of the others may be those of another face, but hardly any overlaps deeper.
    depths = [
        [-contacts[:, 2].min(initial=0.0) for contacts in all_contacts]
        for all_contacts in (found.contacts, found.expected_contacts)
    ]
    assert np.mean(np.abs(np.subtract(*depths)) < 5e-3) > 0.995


@pytest.mark.parametrize("second", PAIRS)
def test_contacts_in_single_precision(second):
    found = compare(scene(), double=False, states=states_of(second, "any", 300))
    error = differences(found)
    assert np.median(error) < 1e-6
    assert np.quantile(error, 0.9) < 1e-4
    # Between 2.8e-6 and 3.2e-6 by the processor, as compilers round differently.
    assert np.median(found.error) < 1e-5


@pytest.mark.parametrize("place", [np.nan, np.inf, 1e30])
def test_a_hull_that_flew_away_touches_nothing(place):
    states = states_of("box", "any", 3)
    for state in states:
        state["qpos"].reshape(-1, 7)[0, 2] = place  # the box
    assert not any(map(len, compare(scene(), states=states, double=False).contacts))


def test_which_pairs_of_hulls_are_found():
    """Those without a margin whose hulls are closed and not too large; with planes and balls all closed ones."""
    kinds = sorted(pair.kind for pair in contact_pairs(scene()))
    assert kinds == ["BOX_HULL"] * 3 + ["HULL_HULL"] * 3 + ["PLANE_HULL"] * 3 + ["SPHERE_HULL"] * 3
    kinds = sorted(pair.kind for pair in contact_pairs(scene(0.01)))
    assert kinds == [""] * 6 + ["PLANE_HULL"] * 3 + ["SPHERE_HULL"] * 3
    assert sides_of_pairs(scene(), contact_pairs(scene())) == 12 + 4
    ball = np.random.default_rng(0).normal(size=(400, 3))
    vertex = " ".join(map(str, (ball / np.linalg.norm(ball, axis=1, keepdims=True)).ravel()))
    bodies = "<body pos='{} 0 2'><freejoint/><geom type='mesh' mesh='m'/></body>"
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><asset><mesh name='m' vertex='{vertex}'/></asset><worldbody><geom type='plane' size='0 0 1'/>"
        f"{bodies.format(0)}{bodies.format(3)}</worldbody></mujoco>"
    )
    assert [pair.kind for pair in contact_pairs(model)] == ["PLANE_HULL", "PLANE_HULL", ""]


def test_a_box_is_a_scaled_cube():
    """The hull of a mesh with the corners of a box has the same faces, edges and corners as the cube."""
    cube, block = Hull.cube(), Hull.of_mesh(scene(), 0)
    order = [int(np.flatnonzero((np.sign(block.vertices) == corner).all(axis=1))[0]) for corner in cube.vertices]
    for own, other in ((cube, block), (block, cube)):
        assert len(own.edges) == 12
        for f, normal in enumerate(own.normals):
            g = int(np.argmax(other.normals @ normal))
            np.testing.assert_allclose(other.normals[g], normal, atol=1e-12)
            assert len(own.faces[f]) == len(other.faces[g]) == 4
    for face, normal in zip(cube.faces, cube.normals, strict=True):
        same = block.faces[int(np.argmax(block.normals @ normal))]
        assert sorted(order[v] for v in face) == sorted(same)
    corners = cube.vertices[[list(face) for face in cube.faces]]
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1])
    assert (np.einsum("fi,fi->f", outwards, cube.normals) > 0.0).all()


def pile(worlds: int) -> SolverFused:
    """A solver of worlds in which a box, a prism and a stone fall on a prism that stands on the ground."""
    one = newton.ModelBuilder()
    SolverFused.register_custom_attributes(one)
    one.rigid_gap = 0.0
    meshes = "".join(
        f"<mesh name='{n}' vertex='{' '.join(f'{x:.6f}' for x in points_of(n).ravel())}'/>" for n in MESHES
    )
    body = "<body pos='{} {} {}' euler='{} {} 0'><freejoint/><geom {} density='500'/></body>"
    shapes = ("type='mesh' mesh='prism'", "type='box' size='.08 .1 .05'", "type='mesh' mesh='stone'")
    bodies = "".join(body.format(0.02 * i, 0.0, 0.1 + 0.24 * i, 20 * i, 30 * i, s) for i, s in enumerate(shapes))
    one.add_mjcf(
        f"<mujoco><asset>{meshes}</asset><worldbody><geom type='plane' size='0 0 1'/>{bodies}</worldbody></mujoco>"
    )
    builder = newton.ModelBuilder()
    SolverFused.register_custom_attributes(builder)
    builder.replicate(one, worlds)
    model = builder.finalize(device="cpu")
    rng, q = np.random.default_rng(0), model.joint_q.numpy().reshape(worlds, 3, 7)
    q[:, :, :2] += rng.uniform(-0.02, 0.02, (worlds, 3, 2))
    model.joint_q.assign(q.ravel())
    return SolverFused(model, njmax=120, nconmax=30, kinematic_switchable_roots=False)


def test_very_many_pairs_are_left_to_mujoco_warp(monkeypatch):
    monkeypatch.setattr(pair_division, "_MOST_HULL_PAIRS", 6)
    assert pile(1).one_launch  # two hulls with the ground, the box and each other: five pairs
    monkeypatch.setattr(pair_division, "_MOST_HULL_PAIRS", 4)
    left = "box and mesh, mesh and mesh, plane and mesh"
    assert pile(1).describe() == f"the fused step, with MuJoCo Warp's collision detection for {left}"


def test_a_pile_comes_to_rest_by_a_thread_and_by_lanes_alike():
    """It lies on the ground, in one launch. On the way lanes find what a thread finds."""
    solver = pile(6)
    assert solver.describe() == "the fused step, all physics steps of a step in one launch"
    lanes, rows, state = emulate(solver, 32), 0, solver.model.state()
    for turn in range(20):
        solver.step_many(state, state, solver.model.control(), 0.004, 50)
        rows += rows_by_thread_and_lanes(solver, lanes) if turn % 5 == 0 else 0
    assert rows > 200
    heights = state.joint_q.numpy().reshape(6, 3, 7)[:, :, 2]
    assert (heights > 0.04).all()
    assert np.abs(state.joint_qd.numpy()).max() < 0.5
