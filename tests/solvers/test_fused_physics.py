# SPDX-License-Identifier: Apache-2.0
"""The fused step against physics: momentum and energy in free flight, friction on a slope, worlds that stay apart."""

from __future__ import annotations

import math

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.solvers import SolverFused

DT = 0.002
ARM = "<body pos='.1 .1 0'><joint axis='0 1 0'/><geom type='capsule' fromto='0 0 0 .2 0 .1' size='.03'/>{}</body>"
TRUNK = "<body pos='0 0 1'><freejoint/><geom type='box' size='.2 .1 .05'/>{}</body>"
ACROBAT = TRUNK.format(ARM.format(ARM.format("")) + ARM.format(""))
BLOCK = "<body pos='0 0 .0995'><freejoint/><geom type='box' size='.2 .2 .1' friction='.5 .01 .001'/></body>"


def replicated(bodies: str, num_worlds: int, gravity: tuple[float, float, float]) -> newton.Model:
    """Worlds with bodies above a plane."""
    one, builder = newton.ModelBuilder(), newton.ModelBuilder()
    for made in (one, builder):
        SolverFused.register_custom_attributes(made)
        made.rigid_gap = 0.0
        made.gravity = wp.vec3(*gravity)
    ground = "<geom type='plane' size='0 0 1' friction='.1 .01 .001'/>"
    one.add_mjcf(f"<mujoco><worldbody>{ground}{bodies}</worldbody></mujoco>")
    one.gravity = wp.vec3(*gravity)
    builder.replicate(one, num_worlds)
    return builder.finalize(device="cpu")


def solver_of(model: newton.Model, **options: object) -> SolverFused:
    return SolverFused(model, njmax=100, nconmax=20, kinematic_switchable_roots=False, **options)


def momenta(model: newton.Model, state: newton.State) -> tuple[np.ndarray, np.ndarray, float]:
    """Linear momentum, angular momentum about the world's origin and kinetic energy of all bodies, in float64."""
    mass, inertia = model.body_mass.numpy().astype(float), model.body_inertia.numpy().astype(float)
    poses, speeds = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
    linear, angular, energy = np.zeros(3), np.zeros(3), 0.0
    for m, own, pose, speed, com in zip(mass, inertia, poses, speeds, model.body_com.numpy(), strict=True):
        x, y, z, w = pose[3:]
        turn = np.array(
            [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
             [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
             [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
        )  # fmt: skip
        spin, at = speed[3:], pose[:3] + turn @ com
        moment = turn @ own @ turn.T @ spin
        linear, angular = linear + m * speed[:3], angular + m * np.cross(at, speed[:3]) + moment
        energy += 0.5 * m * speed[:3] @ speed[:3] + 0.5 * spin @ moment
    return linear, angular, energy


def test_momentum_and_energy_stay_in_free_flight():
    """Without gravity, a body with three arms that swing: what its integrator of first order leaves is of size DT."""
    model = replicated(ACROBAT, 1, (0.0, 0.0, 0.0))
    solver, state = solver_of(model, integrator="euler"), model.state()
    speeds = np.array([0.1, -0.2, 0.3, 1.0, -1.5, 2.0, 1.0, -2.0, 1.5], dtype=np.float32)
    state.joint_qd.assign(speeds)
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    linear, angular, energy = momenta(model, state)
    assert np.linalg.norm(angular) > 0.1
    solver.step_many(state, state, model.control(), DT, 500)
    then = momenta(model, state)
    np.testing.assert_allclose(then[0], linear, atol=2e-3 * np.linalg.norm(linear))
    np.testing.assert_allclose(then[1], angular, atol=2e-2 * np.linalg.norm(angular))
    assert then[2] == pytest.approx(energy, rel=2e-2)
    assert np.abs(state.joint_qd.numpy() - speeds).max() > 0.5  # it is not at rest in its own frame


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_a_block_slides_beyond_the_angle_of_friction(cone):
    """Coulomb: it begins to slide where the slope is the coefficient of friction, the larger one of the two."""
    moved = []
    for slope in (0.45, 0.55):
        angle = math.atan(slope)
        model = replicated(BLOCK, 1, (9.81 * math.sin(angle), 0.0, -9.81 * math.cos(angle)))
        solver, state = solver_of(model, cone=cone, impratio=100.0), model.state()
        solver.step_many(state, state, model.control(), DT, 500)
        moved.append(float(state.joint_q.numpy()[0]))
    assert abs(moved[0]) < 5e-3
    # After a second: half of (g sin - mu g cos) t^2.
    assert moved[1] == pytest.approx(0.5 * 9.81 * (0.55 - 0.5) * math.cos(math.atan(0.55)), rel=0.1)


def test_a_world_that_is_not_finite_stays_alone():
    model = replicated(ACROBAT, 3, (0.0, 0.0, -9.81))
    states = []
    for broken in (False, True):
        solver, state = solver_of(model), model.state()
        if broken:
            speeds = state.joint_qd.numpy()
            speeds[len(speeds) // 3] = np.nan
            state.joint_qd.assign(speeds)
        for _ in range(100):
            solver.step_many(state, state, model.control(), DT, 4)
        states.append(state.joint_q.numpy().reshape(3, -1))
    assert np.isnan(states[1][1]).any()
    np.testing.assert_array_equal(states[1][[0, 2]], states[0][[0, 2]])


@pytest.mark.slow
def test_ten_million_steps_of_worlds_stay_finite():
    """Bodies that fall on the ground, are kicked now and then, and never get lost."""
    worlds, steps = 1000, 10_000
    model = replicated(ACROBAT, worlds, (0.0, 0.0, -9.81))
    solver, state, rng = solver_of(model), model.state(), np.random.default_rng(0)
    for _ in range(steps // 100):
        speeds = state.joint_qd.numpy() + rng.normal(size=state.joint_qd.shape).astype(np.float32)
        state.joint_qd.assign(speeds)
        solver.step_many(state, state, model.control(), DT, 100)
        assert np.isfinite(state.joint_q.numpy()).all()
    assert np.abs(state.joint_q.numpy().reshape(worlds, -1)[:, 2]).max() < 10.0
