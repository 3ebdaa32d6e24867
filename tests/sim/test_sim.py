# SPDX-License-Identifier: Apache-2.0
"""Simulation: against closed-form physics, and the solvers against each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import ellipk

from stripe_newton.actuators import IdealPDActuatorCfg, ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError
from stripe_newton.sim import (
    FeatherstoneSolverCfg,
    KaminoSolverCfg,
    MassPropertiesCfg,
    MuJoCoSolverCfg,
    PhysicsHook,
    RigidBodyPropertiesCfg,
    SemiImplicitSolverCfg,
    Simulation,
    SimulationCfg,
    SphereCfg,
    XPBDSolverCfg,
    resolve_device,
)
from tests.helpers.small_scenes import (
    DT,
    MASS,
    PENDULUM,
    PENDULUM_INERTIA,
    PENDULUM_LENGTH,
    G,
    make_scene,
    mjcf_robot,
    numpy,
    sim_cfg,
)

PASSIVE = {"all": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=0.0, damping=0.0)}


def ball(z: float = 5.0) -> RigidObjectCfg:
    spawn = SphereCfg(radius=0.1, rigid_props=RigidBodyPropertiesCfg(), mass_props=MassPropertiesCfg(mass=1.0))
    state = RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, z), lin_vel=(1.0, 0.0, 2.0))
    return RigidObjectCfg(prim_path="{ENV_REGEX_NS}/Ball", spawn=spawn, init_state=state)


def pendulum(folder, angle: float, **changes) -> ArticulationCfg:
    state = ArticulationCfg.InitialStateCfg(joint_pos={"hinge": angle})
    return mjcf_robot(folder, PENDULUM, init_state=state, actuators=PASSIVE).replace(**changes)


# -- settings


def test_settings_report_every_problem():
    with pytest.raises(ConfigError) as caught:
        Simulation(SimulationCfg(dt=-1.0, render_interval=0, gravity=(0.0, 0.0, math.nan), device="tpu"))
    assert len(caught.value.problems) == 4


@pytest.mark.parametrize("bad", [{"solver": "cgs"}, {"integrator": "verlet"}, {"cone": "round"}, {"njmax": -1}])
def test_solver_options_are_checked(bad):
    with pytest.raises(ConfigError, match=next(iter(bad))):
        SimulationCfg(solver=MuJoCoSolverCfg(**bad)).validate()


def test_device_that_is_not_there():
    with pytest.raises(ValueError, match="this machine has cpu"):
        resolve_device("cuda:77")
    assert resolve_device("cpu") == "cpu"


def test_solver_options_reach_the_solver(tmp_path):
    options = {"iterations": 7, "ls_iterations": 3, "cone": "elliptic", "integrator": "euler", "impratio": 2.0}
    scene = make_scene({"robot": pendulum(tmp_path, 0.1)}, sim=sim_cfg(solver=MuJoCoSolverCfg(**options)))
    solver = scene.sim.solver
    assert solver.mj_model.opt.iterations == 7
    assert solver.mj_model.opt.ls_iterations == 3
    assert solver.mj_model.opt.cone == 1
    assert solver.mj_model.opt.integrator == 0
    assert solver.mj_model.opt.impratio == 2.0


# -- motion


def test_free_fall_is_semi_implicit_euler():
    scene = make_scene({"ball": ball()})
    data = scene.rigid_objects["ball"].data
    scene.controller.reset_robots()
    n = 200
    scene.sim.step(n)
    z = 5.0 + 2.0 * n * DT - G * DT**2 * n * (n + 1) / 2
    np.testing.assert_allclose(numpy(data.root_pos_w - scene.env_origins), [[n * DT, 0.0, z]] * 2, atol=2e-5)
    np.testing.assert_allclose(numpy(data.root_lin_vel_w), [[1.0, 0.0, 2.0 - G * DT * n]] * 2, atol=2e-5)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -3.7), (1.0, -2.0, 0.5), (0.0, 0.0, 0.0)])
def test_gravity_of_the_settings(gravity):
    scene = make_scene({"ball": ball()}, sim=sim_cfg(gravity=gravity))
    scene.sim.step(50)
    velocity = numpy(scene.rigid_objects["ball"].data.root_lin_vel_w)
    np.testing.assert_allclose(velocity, [np.array(gravity) * 50 * DT] * 2, atol=1e-5)
    down = numpy(scene.rigid_objects["ball"].data.GRAVITY_VEC_W)[0]
    length = np.linalg.norm(gravity)
    np.testing.assert_allclose(down, np.array(gravity) / length if length else (0.0, 0.0, -1.0), atol=1e-6)


def period(angles: np.ndarray) -> float:
    """Period from the falling zero crossings of a swing [s]."""
    falling = np.flatnonzero((angles[:-1] > 0) & (angles[1:] <= 0))
    times = falling + angles[falling] / (angles[falling] - angles[falling + 1])
    return float(np.diff(times).mean()) * DT


@pytest.mark.parametrize("start", [0.1, 2.0])
def test_period_of_a_pendulum(tmp_path, start):
    scene = make_scene({"robot": pendulum(tmp_path, start)})
    data, angles = scene.articulations["robot"].data, []
    for _ in range(1900):
        scene.sim.step(1)
        angles.append(float(data.joint_pos[0, 0]))
    omega = math.sqrt(2.0 * G * PENDULUM_LENGTH / PENDULUM_INERTIA)
    exact = 4.0 * ellipk(math.sin(start / 2.0) ** 2) / omega
    assert period(np.array(angles)) == pytest.approx(exact, rel=2e-3)


def test_substeps_in_one_call_equal_single_steps(tmp_path):
    one, many = (make_scene({"robot": pendulum(tmp_path, 1.0)}) for _ in range(2))
    one.sim.step(12)
    for _ in range(12):
        many.sim.step(1)
    assert torch.equal(one.articulations["robot"].data.joint_pos, many.articulations["robot"].data.joint_pos)
    assert torch.equal(one.articulations["robot"].data.joint_acc, many.articulations["robot"].data.joint_acc)


def test_environments_do_not_depend_on_their_number(tmp_path):
    results = []
    for count in (1, 5):
        scene = make_scene({"robot": pendulum(tmp_path, 1.0)}, num_envs=count)
        scene.sim.step(100)
        results.append(scene.articulations["robot"].data.joint_pos[0].clone())
    assert torch.equal(*results)


# -- several simulations in one process

SOLVERS = {
    "featherstone": (FeatherstoneSolverCfg(), 0.01),
    "xpbd": (XPBDSolverCfg(iterations=20), 0.05),
    "semi_implicit": (SemiImplicitSolverCfg(), 0.08),
    "kamino": (KaminoSolverCfg(), 0.02),
}


@pytest.mark.parametrize("name", [n if n != "kamino" else pytest.param(n, marks=pytest.mark.slow) for n in SOLVERS])
def test_solvers_agree_on_a_pendulum(tmp_path, name):
    solver, tolerance = SOLVERS[name]
    reference = make_scene({"robot": pendulum(tmp_path, 0.8)}, sim=sim_cfg(dt=0.0005))
    other = make_scene({"robot": pendulum(tmp_path, 0.8)}, sim=sim_cfg(dt=0.0005, solver=solver))
    for _ in range(4):
        reference.sim.step(100)
        other.sim.step(100)
        for field in ("joint_pos", "joint_vel", "body_lin_vel_w", "body_ang_vel_w"):
            got, want = (numpy(getattr(s.articulations["robot"].data, field)) for s in (other, reference))
            np.testing.assert_allclose(got, want, atol=tolerance, err_msg=f"{name}: {field}")
    assert abs(float(reference.articulations["robot"].data.joint_pos[0, 0]) - 0.8) > 0.1  # it moved


@pytest.mark.parametrize("name", SOLVERS)
def test_free_fall_with_every_solver(name):
    scene = make_scene({"ball": ball()}, sim=sim_cfg(solver=SOLVERS[name][0]))
    scene.controller.reset_robots()
    scene.sim.forward()
    scene.sim.step(100)
    data = scene.rigid_objects["ball"].data
    t = 100 * DT
    exact = np.array([t, 0.0, 5.0 + 2.0 * t - 0.5 * G * t * t])
    np.testing.assert_allclose(numpy(data.root_pos_w - scene.env_origins), [exact] * 2, atol=0.01)
    np.testing.assert_allclose(numpy(data.root_lin_vel_w), [[1.0, 0.0, 2.0 - G * t]] * 2, atol=0.03)
    assert torch.equal(data.root_pos_w, data.body_pos_w[:, 0])


@pytest.mark.parametrize("name", [n if n != "kamino" else pytest.param(n, marks=pytest.mark.slow) for n in SOLVERS])
def test_writing_state_reaches_every_solver(tmp_path, name):
    """A reset in one world takes effect there, and leaves the other as it would have been."""
    tolerance = 0.05
    scene = make_scene({"robot": pendulum(tmp_path, 0.5)}, sim=sim_cfg(dt=0.0005, solver=SOLVERS[name][0]))
    alone = make_scene({"robot": pendulum(tmp_path, 0.5)}, sim=sim_cfg(dt=0.0005, solver=SOLVERS[name][0]))
    for s in (scene, alone):
        s.sim.step(200)
    robot = scene.articulations["robot"]
    scene.reset([1])
    robot.write_joint_state_to_sim(torch.tensor([[-0.5]]), torch.tensor([[0.0]]), env_ids=[1])
    scene.sim.forward(scene.controller.mask([1]))
    for s in (scene, alone):
        s.sim.step(200)
    got, want = numpy(robot.data.joint_pos), numpy(alone.articulations["robot"].data.joint_pos)
    fresh = make_scene({"robot": pendulum(tmp_path, 0.5)}, sim=sim_cfg(dt=0.0005, solver=SOLVERS[name][0]))
    fresh.sim.step(200)
    assert got[0, 0] == pytest.approx(want[0, 0], abs=1e-5)
    assert got[1, 0] == pytest.approx(-numpy(fresh.articulations["robot"].data.joint_pos)[1, 0], abs=tolerance)


def test_two_simulations_do_not_disturb_each_other(tmp_path):
    alone = make_scene({"robot": pendulum(tmp_path, 1.0)})
    alone.sim.step(60)
    one, two = (make_scene({"robot": pendulum(tmp_path, a)}) for a in (1.0, -0.3))
    for _ in range(60):
        one.sim.step(1)
        two.sim.step(1)
    assert torch.equal(one.articulations["robot"].data.joint_pos, alone.articulations["robot"].data.joint_pos)
    assert float(two.articulations["robot"].data.joint_pos[0, 0]) > -0.3
    two.close()
    one.sim.step(1)


# -- a GPU


@pytest.mark.gpu
def test_physics_is_one_graph_that_equals_eager_stepping(tmp_path):
    state = ArticulationCfg.InitialStateCfg(joint_pos={"hinge": 1.0})
    ideal = {"pd": IdealPDActuatorCfg(joint_names_expr=[".*"], stiffness=5.0, damping=0.2, effort_limit=3.0)}
    robot = mjcf_robot(tmp_path, PENDULUM, init_state=state, actuators=ideal)
    graph = make_scene({"robot": robot}, sim=sim_cfg(device="cuda:0"))
    eager = make_scene({"robot": robot}, sim=sim_cfg(device="cuda:0", use_cuda_graph=False))
    for step in range(30):
        for scene in (graph, eager):
            scene.articulations["robot"].set_joint_position_target(torch.full((2, 1), 0.01 * step, device="cuda:0"))
            scene.sim.step(4)
    assert list(graph.sim._graphs) == [4]
    assert not eager.sim._graphs
    for field in ("joint_pos", "joint_vel", "body_pose_w", "joint_acc"):
        one, two = (getattr(s.articulations["robot"].data, field) for s in (graph, eager))
        assert torch.equal(one, two), field
    assert float(graph.articulations["robot"].data.joint_vel.abs().max()) > 0.0


@pytest.mark.gpu
def test_an_external_force_is_felt_after_the_graph_was_recorded():
    scene = make_scene({"ball": ball()}, sim=sim_cfg(device="cuda:0", gravity=(0.0, 0.0, 0.0)))
    asset = scene.rigid_objects["ball"]
    scene.sim.step(4)
    scene.sim.step(4)
    force = torch.tensor([3.0, 0.0, 0.0], device="cuda:0").repeat(2, 1, 1)
    before = asset.data.root_lin_vel_w.clone()
    asset.set_external_force_and_torque(force, torch.zeros_like(force), is_global=True)
    for _ in range(3):
        scene.sim.step(4)
    gained = numpy(asset.data.root_lin_vel_w - before)
    np.testing.assert_allclose(gained, [[3.0 * 12 * DT, 0.0, 0.0]] * 2, atol=1e-5)


def test_the_solver_says_how_many_launches_a_step_takes():
    sim = make_scene({"ball": ball()}, sim=sim_cfg(solver=MuJoCoSolverCfg())).sim
    assert sim.describe_solver().endswith("all physics steps of a step in one launch")
    sim.enable_external_wrench()
    sim.limit_velocities()
    assert sim.describe_solver().endswith("all physics steps of a step in one launch")

    class Follower(PhysicsHook):
        follows_each_step = True

    sim.add_hook(Follower())
    assert sim.describe_solver() == "the fused step, a launch for each physics step because of Follower"


def test_mass_of_the_sliders_is_what_the_tests_assume(tmp_path):
    from tests.helpers.small_scenes import sliders

    scene = make_scene({"robot": mjcf_robot(tmp_path, sliders({"x": "1 0 0"}))})
    assert scene.articulations["robot"].data.body_mass[0].tolist() == [1.0, MASS]


def test_shapes_that_do_not_touch_are_no_contacts_to_mujoco():
    for contacts_of_mujoco, gap in ((True, 0.0), (False, 0.1)):
        solver = MuJoCoSolverCfg(use_mujoco_contacts=contacts_of_mujoco)
        builder = Simulation(SimulationCfg(device="cpu", solver=solver)).new_builder()
        builder.add_shape_sphere(builder.add_body())
        assert builder.shape_gap == [gap]
