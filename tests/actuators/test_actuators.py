# SPDX-License-Identifier: Apache-2.0
"""Actuators: drives, limits and passive properties of joints, against the laws that they state."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from stripe_newton.actuators import IdealPDActuatorCfg, ImplicitActuatorCfg
from stripe_newton.sim import XPBDSolverCfg
from tests.helpers.small_scenes import DT, MASS, G, make_scene, mjcf_robot, numpy, sim_cfg, sliders

JOINTS = ("bare", "drive", "weak", "fast", "heavy", "sticky", "ideal", "speed", "lift", "damped")
ARMATURE, FRICTION, VISCOUS = 3.0, 4.0, 1.5


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    text = sliders({name: "0 0 1" if name == "lift" else "1 0 0" for name in JOINTS})
    none = {"stiffness": 0.0, "damping": 0.0}
    actuators = {
        "bare": ImplicitActuatorCfg(joint_names_expr=["bare"], **none),
        "drive": ImplicitActuatorCfg(joint_names_expr=["drive"], stiffness=100.0, damping=4.0),
        "weak": ImplicitActuatorCfg(joint_names_expr=["weak"], stiffness=1000.0, damping=1.0, effort_limit=5.0),
        "fast": ImplicitActuatorCfg(joint_names_expr=["fast"], velocity_limit_sim=1.5, **none),
        "heavy": ImplicitActuatorCfg(joint_names_expr=["heavy"], armature=ARMATURE, **none),
        "sticky": ImplicitActuatorCfg(joint_names_expr=["sticky"], friction=FRICTION, **none),
        "ideal": IdealPDActuatorCfg(joint_names_expr=["ideal"], stiffness=50.0, damping=3.0, effort_limit=6.0),
        "speed": ImplicitActuatorCfg(joint_names_expr=["speed"], stiffness=0.0, damping=10.0),
        "lift": ImplicitActuatorCfg(joint_names_expr=["lift"], stiffness={"li.*": 200.0}, damping={".*": 40.0}),
        "damped": ImplicitActuatorCfg(joint_names_expr=["damped"], viscous_friction=VISCOUS, **none),
    }
    robot = mjcf_robot(tmp_path_factory.mktemp("robot"), text, actuators=actuators)
    return make_scene({"robot": robot})


@pytest.fixture
def robot(scene):
    """The robot at rest with its targets cleared."""
    robot = scene.articulations["robot"]
    scene.controller.reset_robots()
    scene.sim.forward()
    return robot


def column(robot, name: str) -> int:
    return robot.find_joints(name)[0][0]


def set_targets(robot, kind: str, **values: float) -> None:
    for name, value in values.items():
        target = torch.full((2, 1), value)
        getattr(robot, f"set_joint_{kind}_target")(target, joint_ids=[column(robot, name)])


def after(robot, steps: int, name: str, field: str = "joint_vel") -> float:
    robot._sim.step(steps)
    values = getattr(robot.data, field)[:, column(robot, name)]
    assert torch.equal(values[0], values[1])
    return float(values[0])


def test_effort_over_mass_is_acceleration(robot):
    set_targets(robot, "effort", bare=3.0)
    n = 50
    assert after(robot, n, "bare") == pytest.approx(3.0 / MASS * n * DT, rel=1e-5)
    assert after(robot, 0, "bare", "joint_pos") == pytest.approx(3.0 / MASS * DT**2 * n * (n + 1) / 2, rel=1e-4)
    assert after(robot, 0, "bare", "joint_acc") == pytest.approx(3.0 / MASS, rel=1e-3)
    assert after(robot, 0, "bare", "applied_torque") == pytest.approx(3.0, rel=1e-5)


def test_a_position_drive_under_load_settles_at_force_over_stiffness(robot):
    assert after(robot, 1500, "lift", "joint_pos") == pytest.approx(-MASS * G / 200.0, rel=1e-3)
    assert after(robot, 0, "lift", "applied_torque") == pytest.approx(MASS * G, rel=1e-3)


def test_the_implicit_drive_is_the_pd_law(robot):
    """Against the equation of motion integrated by scipy, with the velocity target fed forward."""
    set_targets(robot, "position", drive=0.3)
    set_targets(robot, "velocity", drive=0.7)

    def law(_, y):
        return [y[1], (100.0 * (0.3 - y[0]) + 4.0 * (0.7 - y[1])) / MASS]

    exact = solve_ivp(law, (0.0, 0.6), [0.0, 0.0], rtol=1e-10, atol=1e-12, t_eval=[0.2, 0.4, 0.6]).y
    for k in range(3):
        assert after(robot, 100, "drive", "joint_pos") == pytest.approx(exact[0, k], abs=6e-3)
        assert after(robot, 0, "drive") == pytest.approx(exact[1, k], abs=3e-2)


def test_one_implicit_step_by_hand(robot):
    """Damping is integrated implicitly: ``(m + dt kd) dv = dt (ke (q* - q) - kd v)``."""
    i = column(robot, "drive")
    robot.write_joint_state_to_sim(torch.full((2, 1), 0.2), torch.full((2, 1), 1.1), [i])
    set_targets(robot, "position", drive=-0.1)
    v = 1.1 + DT * (100.0 * (-0.1 - 0.2) - 4.0 * 1.1) / (MASS + DT * 4.0)
    assert after(robot, 1, "drive") == pytest.approx(v, rel=1e-5)


def test_feed_forward_of_velocity_targets_follows_changed_gains(robot, scene):
    i = column(robot, "drive")
    try:
        robot.write_joint_damping_to_sim(torch.full((2, 1), 9.0), [i])
        set_targets(robot, "velocity", drive=0.5)
        assert after(robot, 1, "drive") == pytest.approx(DT * 9.0 * 0.5 / (MASS + DT * 9.0), rel=1e-4)
    finally:
        robot.write_joint_damping_to_sim(torch.full((2, 1), 4.0), [i])
    assert float(robot.data.joint_damping[0, i]) == 4.0


def test_a_velocity_drive_settles_at_its_target(robot):
    set_targets(robot, "velocity", speed=0.8)
    v = 0.0
    for _ in range(400):
        v += DT * 10.0 * (0.8 - v) / (MASS + DT * 10.0)
    assert after(robot, 400, "speed") == pytest.approx(v, rel=1e-4)
    torque = after(robot, 0, "speed", "applied_torque")
    assert torque == pytest.approx(10.0 * (0.8 - v), abs=0.05)


def test_the_effort_limit_binds_drive_and_effort_target(robot):
    set_targets(robot, "position", weak=10.0)
    n = 20
    assert after(robot, n, "weak") == pytest.approx(5.0 / MASS * n * DT, rel=1e-3)
    set_targets(robot, "position", weak=0.0)
    robot.write_joint_state_to_sim(torch.zeros(2, len(JOINTS)), torch.zeros(2, len(JOINTS)))
    set_targets(robot, "effort", weak=-80.0)
    assert after(robot, 1, "weak") == pytest.approx(-5.0 / MASS * DT, rel=1e-2)


def test_an_effort_that_is_not_a_number_shows_in_its_own_world_alone(robot, scene):
    name, speed = column(robot, "weak"), column(robot, "fast")  # both have a limit that could hide it
    for joint in (name, speed):
        robot.reset()
        robot.set_joint_effort_target(torch.tensor([[1.0], [math.nan]]), joint_ids=[joint])
        scene.sim.step(2)
        assert robot.data.joint_vel[1].isnan().any()
        assert float(robot.data.joint_vel[0, joint]) == pytest.approx(2 * DT * 1.0 / MASS, rel=0.1)
        scene.controller.reset_robots()
        scene.sim.step(2)
        assert robot.data.joint_vel.isfinite().all()


def test_speed_is_held_to_its_limit(robot):
    set_targets(robot, "effort", fast=200.0)
    top = 0.0
    for _ in range(20):
        top = max(top, abs(after(robot, 1, "fast")))
    assert top == pytest.approx(1.5, rel=1e-6)
    body = robot.find_bodies("fast")[0][0]
    assert float(robot.data.body_lin_vel_w[0, body, 0]) == pytest.approx(1.5, rel=1e-6)
    robot.write_joint_velocity_to_sim(torch.full((2, 1), -9.0), [column(robot, "fast")])
    set_targets(robot, "effort", fast=0.0)
    assert after(robot, 1, "fast") == pytest.approx(-1.5, rel=1e-6)
    assert after(robot, 0, "bare") == 0.0


def test_armature_adds_inertia(robot):
    set_targets(robot, "effort", heavy=3.0)
    assert after(robot, 50, "heavy") == pytest.approx(3.0 / (MASS + ARMATURE) * 50 * DT, rel=1e-4)


def test_coulomb_friction_holds_and_slows(robot):
    set_targets(robot, "effort", sticky=0.9 * FRICTION)
    assert abs(after(robot, 200, "sticky")) < 0.02
    set_targets(robot, "effort", sticky=3.0 * FRICTION)
    before = after(robot, 0, "sticky")
    gained = after(robot, 200, "sticky") - before
    assert gained == pytest.approx(2.0 * FRICTION / MASS * 200 * DT, rel=0.02)


def test_viscous_friction_decays_speed(robot):
    robot.write_joint_velocity_to_sim(torch.full((2, 1), 2.0), [column(robot, "damped")])
    assert after(robot, 250, "damped") == pytest.approx(2.0 * math.exp(-VISCOUS / MASS * 250 * DT), rel=1e-3)


def test_ideal_pd_is_its_law_and_is_clamped(robot):
    i = column(robot, "ideal")
    q, v, worst, clamped = 0.0, 0.2, 0.0, 0
    robot.write_joint_state_to_sim(torch.full((2, 1), q), torch.full((2, 1), v), [i])
    set_targets(robot, "position", ideal=0.3)
    set_targets(robot, "velocity", ideal=-0.4)
    set_targets(robot, "effort", ideal=1.0)
    for _ in range(400):
        effort = 50.0 * (0.3 - q) + 3.0 * (-0.4 - v) + 1.0
        clamped += abs(effort) > 6.0
        effort = min(max(effort, -6.0), 6.0)
        v += DT * effort / MASS
        q += DT * v
        worst = max(worst, abs(after(robot, 1, "ideal", "joint_pos") - q))
        assert after(robot, 0, "ideal", "applied_torque") == pytest.approx(effort, abs=2e-3)
    assert worst < 1e-4
    assert 0 < clamped < 400


def test_properties_are_reported_by_joint(robot):
    data = robot.data
    expected = {
        "joint_stiffness": {"drive": 100.0, "weak": 1000.0, "lift": 200.0, "ideal": 50.0},
        "joint_damping": {"drive": 4.0, "weak": 1.0, "speed": 10.0, "lift": 40.0, "ideal": 3.0},
        "joint_armature": {"heavy": ARMATURE, "bare": 0.0},
        "joint_friction_coeff": {"sticky": FRICTION, "bare": 0.0},
        "joint_effort_limits": {"weak": 5.0, "ideal": 6.0},
        "joint_vel_limits": {"fast": 1.5},
    }
    for field, values in expected.items():
        for name, value in values.items():
            assert getattr(data, field)[:, column(robot, name)].tolist() == [value, value], (field, name)


def test_properties_written_while_running_are_felt(robot):
    i = column(robot, "bare")
    set_targets(robot, "effort", bare=6.0)
    other = column(robot, "heavy")
    try:
        robot.write_joint_armature_to_sim(torch.full((1, 1), 4.0), [i], [1])
        robot._sim.step(10)
        speeds = robot.data.joint_vel[:, i].tolist()
        assert speeds == pytest.approx([6.0 / MASS * 10 * DT, 6.0 / (MASS + 4.0) * 10 * DT], rel=1e-4)
        robot.write_joint_armature_to_sim(0.0, [i])
        robot.write_joint_friction_coefficient_to_sim(8.0, [i])
        robot.write_joint_velocity_to_sim(0.0, [i])
        robot._sim.step(50)
        assert abs(float(robot.data.joint_vel[0, i])) < 0.02
        robot.write_joint_friction_coefficient_to_sim(0.0, [i])
        robot.write_joint_effort_limit_to_sim(1.0, [i])
        robot.write_joint_velocity_to_sim(0.0, [i])
        robot._sim.step(10)
        assert robot.data.joint_vel[:, i].tolist() == pytest.approx([1.0 / MASS * 10 * DT] * 2, rel=1e-3)
        robot.write_joint_stiffness_to_sim(100.0, [other])
    finally:
        robot.write_joint_armature_to_sim(0.0, [i])
        robot.write_joint_friction_coefficient_to_sim(0.0, [i])
        robot.write_joint_effort_limit_to_sim(1.0e6, [i])
        robot.write_joint_stiffness_to_sim(0.0, [other])


def test_position_limits_written_while_running_hold(tmp_path):
    scene = make_scene(
        {
            "robot": mjcf_robot(
                tmp_path, sliders({"x": "1 0 0"}).replace('axis="1 0 0"', 'axis="1 0 0" range="-1 1" limited="true"')
            )
        }
    )
    robot = scene.articulations["robot"]
    assert robot.data.joint_pos_limits[0, 0].tolist() == [-1.0, 1.0]
    robot.write_joint_position_limit_to_sim(torch.tensor([[[-0.1, 0.2]]]), env_ids=[1])
    robot.set_joint_effort_target(torch.full((2, 1), 4.0))
    scene.sim.step(600)
    positions = robot.data.joint_pos[:, 0].tolist()
    assert positions == pytest.approx([1.0, 0.2], abs=0.05)


@pytest.mark.parametrize("drive_limits", [False, True])
def test_implicit_drives_equal_mujoco_position_actuators(drive_limits, tmp_path):
    """The same mechanism with the drives as actuators of MuJoCo's C engine."""
    text = sliders({"a": "1 0 0", "b": "0 0 1"}).replace(
        "<mujoco>", f'<mujoco><option timestep="{DT}" integrator="implicitfast"/>'
    )
    plain = text.replace(
        "</mujoco>",
        '<actuator><position joint="a" kp="60" kv="5"/><position joint="b" kp="300" kv="20"/></actuator></mujoco>',
    )
    limit = ('kv="5"', 'kv="5" forcerange="-7 7"'), ('"a" type', '"a" actuatorfrcrange="-7 7" type')
    plain = plain.replace(*limit[0 if drive_limits else 1])
    model = mujoco.MjModel.from_xml_string(plain)
    data = mujoco.MjData(model)
    actuators = {
        "a": ImplicitActuatorCfg(joint_names_expr=["a"], stiffness=60.0, damping=5.0, effort_limit_sim=7.0),
        "b": ImplicitActuatorCfg(joint_names_expr=["b"], stiffness=300.0, damping=20.0),
    }
    sim = sim_cfg()
    sim.solver.drive_limits = drive_limits
    scene = make_scene({"robot": mjcf_robot(tmp_path, text, actuators=actuators)}, sim=sim)
    robot = scene.articulations["robot"]
    target = [0.5, 0.1]
    robot.set_joint_position_target(torch.tensor([target, target]))
    data.ctrl[:] = target
    for _ in range(4):
        mujoco.mj_step(model, data, 100)
        scene.sim.step(100)
        np.testing.assert_allclose(numpy(robot.data.joint_pos)[0], data.qpos, atol=2e-4)
        np.testing.assert_allclose(numpy(robot.data.applied_torque)[0], data.qfrc_actuator, atol=2e-2)


def test_drives_with_another_solver_settle_too(tmp_path):
    robot = mjcf_robot(
        tmp_path,
        sliders({"a": "0 0 1"}),
        actuators={"a": IdealPDActuatorCfg(joint_names_expr=["a"], stiffness=200.0, damping=40.0, effort_limit=100.0)},
    )
    scene = make_scene({"robot": robot}, sim=sim_cfg(solver=XPBDSolverCfg(iterations=8)))
    scene.sim.step(1000)
    assert float(scene.articulations["robot"].data.joint_pos[0, 0]) == pytest.approx(-MASS * G / 200.0, rel=0.1)
