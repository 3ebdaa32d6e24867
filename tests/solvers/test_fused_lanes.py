# SPDX-License-Identifier: Apache-2.0
"""The fused step by lanes that share a world, as on a GPU, against that of a thread a world."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import torch
import warp as wp

import stripe_tasks  # noqa: F401 - registers the tasks
from stripe_newton.assets import RobotNotFoundError
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.launch_arguments import ConvertedState, StepCall
from tests.helpers.lane_emulator import emulate
from tests.helpers.limb_models import walker_worlds
from tests.helpers.step_meshes import FRAMES, model_of, random_poses, step_mesh

STATE = "qpos", "qvel", "qacc_warmstart"


def both(solver: SolverFused, lanes: int, steps: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """State and numbers of constraint rows after some steps from now on, by a thread a world and by lanes."""
    emulated, data = emulate(solver, lanes), solver.mjw_data
    before = {name: getattr(data, name).numpy().copy() for name in STATE}
    found = []
    for is_emulated in (False, True):
        for name, value in before.items():
            getattr(data, name).assign(value)
        if is_emulated:
            emulated(steps)
        else:
            solver.fused.launch(solver.launcher.arguments(solver._call), data.nworld, "cpu", steps)
        found.append({name: getattr(data, name).numpy().copy() for name in (*STATE, "nefc")})
    return found[0], found[1]


def assert_no_race(solver: SolverFused, lanes: int, steps: int) -> None:
    """The same bits by lanes that take turns in the opposite order, and with other numbers in memory at first."""
    emulated, data = emulate(solver, lanes), solver.mjw_data
    before = {name: getattr(data, name).numpy().copy() for name in STATE}
    found = []
    for options in ({}, {"backwards": True}, {"before": 1.25}):
        for name, value in before.items():
            getattr(data, name).assign(value)
        emulated(steps, **options)
        found.append({name: getattr(data, name).numpy().copy() for name in (*STATE, "nefc")})
    for other in found[1:]:
        for name, expected in found[0].items():
            np.testing.assert_array_equal(other[name], expected, name)


def assert_same(one: dict[str, np.ndarray], two: dict[str, np.ndarray], tolerance: float) -> None:
    assert np.array_equal(one["nefc"], two["nefc"])
    for name in ("qpos", "qvel"):
        scale = np.abs(one[name]).max(axis=1, keepdims=True) + 1e-3
        assert np.abs((one[name] - two[name]) / scale).max() < tolerance, name


@pytest.mark.parametrize(
    ("task", "lanes", "limbs"),
    [
        ("Stripe-Velocity-Flat-Quadruped-v0", 32, False),
        ("Stripe-Velocity-Rough-Quadruped-v0", 32, False),
        ("Stripe-Velocity-Flat-AnymalC-v0", 32, False),  # elliptic cones
        pytest.param("Stripe-Velocity-Flat-Humanoid-v0", 32, False, marks=pytest.mark.slow),  # tiles of four rows
        ("Stripe-Velocity-Flat-G1-v0", 32, False),  # rows without Jacobians, more rows of matrices than lanes
        ("Stripe-Cartpole-v0", 8, False),
        ("Stripe-Velocity-Flat-Quadruped-v0", 4, True),
        ("Stripe-Velocity-Flat-Humanoid-v0", 4, True),
    ],
)
def test_tasks(task, lanes, limbs):
    try:
        cfg = load_cfg(task, "env")
    except RobotNotFoundError:
        pytest.skip("the robot's file is not on this machine")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = 6, "cpu", 3
    env = make_env(task, cfg).unwrapped
    env.reset(seed=3)
    env.sim.solver.limbs = limbs
    generator = torch.Generator().manual_seed(0)
    rows = 0
    for _ in range(5):
        for _ in range(4):
            env.step(2.0 * torch.rand((6, *env.single_action_space.shape), generator=generator) - 1.0)
        one, two = both(env.sim.solver, lanes, 2)
        assert env.sim.solver.fused.layout.is_limbs == limbs
        assert_same(one, two, 2e-3)
        rows += int(one["nefc"].sum())
    assert rows or "Cartpole" in task
    assert_no_race(env.sim.solver, lanes, 2)
    env.close()


@pytest.mark.parametrize(
    ("walker", "lanes", "limbs"),
    [
        ("floating", 4, True),
        ("floating", 32, False),
        ("many legs", 32, False),
        pytest.param("many legs", 8, False, marks=pytest.mark.slow),
    ],
)
def test_newton_state_of_worlds_that_share_a_warp(walker, lanes, limbs):
    """Eight worlds and three, of which some are pushed, by a body's wrench or by a free joint's.

    A lane has one row of the matrices or two, or, of the last, none: it has more degrees of freedom than twice the
    lanes.
    """
    model, rng = walker_worlds(walker, 11), np.random.default_rng(4)
    solver = SolverFused(model, njmax=160, nconmax=40, kinematic_switchable_roots=False)
    solver.limbs = limbs
    start, control = model.state(), model.control()
    for array in (start.joint_qd, control.joint_target_q, control.joint_target_qd):
        array.assign(rng.uniform(-0.5, 0.5, array.shape).astype(np.float32))
    pushes, forces = np.zeros((11, model.body_count // 11, 6)), np.zeros((11, model.joint_dof_count // 11))
    pushes[[2, 8], 3] = rng.uniform(-30.0, 30.0, 6)
    forces[5, :6], forces[:, 6:] = 20.0, rng.uniform(-1.0, 1.0, forces[:, 6:].shape)
    start.body_f.assign(pushes.reshape(-1, 6).astype(np.float32))
    control.joint_f.assign(forces.reshape(-1).astype(np.float32))
    emulated, warm = emulate(solver, lanes), solver.mjw_data.qacc_warmstart
    assert solver.fused.layout.is_limbs == limbs
    found = []
    for is_emulated in (False, True, False):
        end, observables = model.state(), solver.observables({"qfrc_actuator"})
        efforts = observables.qfrc_actuator
        before = wp.zeros_like(start.joint_q), wp.zeros_like(start.joint_qd)
        converted = ConvertedState(start, end, control, observables, reads_state=True)
        solver._call = StepCall(before=before, state=converted)
        warm.zero_()
        if is_emulated:
            emulated(3)
        else:
            solver.fused.launch(solver.launcher.arguments(solver._call), 11, "cpu", 3)
        arrays = *before, end.joint_q, end.joint_qd, end.body_q, end.body_qd, efforts, warm, solver.mjw_data.qpos
        found.append([array.numpy().reshape(11, -1).copy() for array in arrays])
        if is_emulated:  # and once more without pushes
            forces[5, :6] = 0.0
            start.body_f.zero_()
            control.joint_f.assign(forces.reshape(-1).astype(np.float32))
    for one, two in zip(*found[:2], strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-3, atol=1e-3)
    are_pushed = (found[0][3] != found[2][3]).any(axis=1)
    assert np.flatnonzero(are_pushed).tolist() == [2, 5, 8]


SHAPES = {
    "sphere": lambda b, body: b.add_shape_sphere(body, radius=0.1),
    "capsule": lambda b, body: b.add_shape_capsule(body, radius=0.05, half_height=0.1),
    "box": lambda b, body: b.add_shape_box(body, hx=0.1, hy=0.08, hz=0.05),
}


@pytest.mark.parametrize(
    ("lanes", "fineness", "solid"),
    [
        (32, 4, True),  # many more candidates than lanes
        (8, 4, False),
        pytest.param(32, 0, True, marks=pytest.mark.slow),
        pytest.param(32, 4, False, marks=pytest.mark.slow),
        pytest.param(8, 0, True, marks=pytest.mark.slow),
    ],
)
def test_shapes_on_a_mesh(lanes, fineness, solid):
    rng = np.random.default_rng(1)
    points = rng.uniform([0.8, 0.2, 0.9], [1.3, 0.8, 1.15], size=(20, 3))

    def add(builder: newton.ModelBuilder, body: int) -> None:
        for at, shape in enumerate(SHAPES.values()):
            other = builder.add_body() if at else body
            shape(builder, other)

    poses = random_poses(rng, points)
    model = model_of(step_mesh(fineness, solid), add, poses, FRAMES[0])
    joint_q = model.joint_q.numpy().reshape(20, 3, 7)
    joint_q[:, 1:] = random_poses(rng, points[rng.permutation(20)]).reshape(20, 1, 7)
    joint_q[:, 2, 2] += 0.05
    model.joint_q.assign(joint_q.reshape(-1))
    solver = SolverFused(model, nconmax=60, njmax=240, kinematic_switchable_roots=False)
    solver.static_triangles = True
    assert solver.missing_triangle_contacts() == []
    state = model.state()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    solver.step(state, state, model.control(), None, 1e-4)
    one, two = both(solver, lanes, 1)
    assert one["nefc"].sum() > 100
    assert_same(one, two, 2e-3)
