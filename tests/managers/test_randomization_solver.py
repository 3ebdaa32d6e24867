# SPDX-License-Identifier: Apache-2.0
"""Randomised models in the solver, against MuJoCo with the same numbers."""

from __future__ import annotations

from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest
import torch

from stripe_kernels import mdp
from stripe_newton.actuators import IdealPDActuatorCfg
from stripe_newton.assets import ArticulationCfg
from stripe_newton.managers import EventTermCfg
from stripe_newton.sim import FeatherstoneSolverCfg, MjcfFileCfg, MuJoCoSolverCfg
from stripe_tasks.robots import CARTPOLE_CFG, QUADRUPED_CFG
from tests.helpers.randomization_world import RandomizedWorld, event, events

N = 3


def constants_agree(world: RandomizedWorld, mjcf: Path) -> None:
    mine = world.solver_model()
    for env in range(world.context.num_envs):
        model, _ = world.reference(mjcf, env)
        hinges = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
        names = ["body_mass", "body_ipos", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0"]
        names += ["dof_armature", "dof_frictionloss", "dof_damping", "jnt_stiffness", "actuator_gainprm"]
        names += ["actuator_biasprm", "geom_friction", "geom_gap", "geom_rbound", "geom_pos"]
        for name in names:
            theirs = getattr(model, name)
            scale = np.abs(theirs).max(initial=1e-9)
            np.testing.assert_allclose(
                mine[name][env].reshape(theirs.shape), theirs, rtol=1e-4, atol=1e-5 * scale, err_msg=name
            )
        np.testing.assert_allclose(mine["jnt_range"][env][hinges], model.jnt_range[hinges], rtol=1e-6)
        np.testing.assert_allclose(mine["jnt_actfrcrange"][env][hinges], model.jnt_actfrcrange[hinges], rtol=1e-6)
        np.testing.assert_allclose(mine["gravity"][env], model.opt.gravity, rtol=1e-6)


def step_agrees(world: RandomizedWorld, mjcf: Path, height: float = 0.25) -> None:
    """Bend the legs to their limits, feet in the ground, and compare the accelerations of one step."""
    data, sim = world.robot.data, world.sim
    rng = np.random.default_rng(0)
    for env in range(world.context.num_envs):
        data.joint_pos[env] += torch.from_numpy(rng.uniform(-0.3, 0.3, data.joint_pos.shape[1])).float()
        data.joint_vel[env] = 0.5
        data.joint_pos_target[env] = data.default_joint_pos[env] + 0.2
        data.root_pose_w[env, 2] = height
    sim.forward()
    solver = sim.solver
    solver._update_mjc_data(solver.mjw_data, sim.model, sim.state)
    qpos, qvel = solver.mjw_data.qpos.numpy().copy(), solver.mjw_data.qvel.numpy().copy()
    sim.step()
    after, ctrl = solver.mjw_data.qvel.numpy(), solver.mjw_data.ctrl.numpy()
    contacts = 0
    for env in range(world.context.num_envs):
        model, state = world.reference(mjcf, env)
        model.opt.timestep = sim.physics_dt
        state.qpos[:], state.qvel[:], state.ctrl[:] = qpos[env], qvel[env], ctrl[env]
        mujoco.mj_step(model, state)
        contacts += state.ncon
        wanted = (state.qvel - qvel[env]) / model.opt.timestep
        found = (after[env] - qvel[env]) / model.opt.timestep
        np.testing.assert_allclose(found, wanted, atol=1e-4 * np.abs(wanted).max())
    assert contacts >= 4 * world.context.num_envs


@pytest.fixture(scope="module")
def mjcf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mjcf") / "model.xml"


@pytest.fixture(scope="module")
def world(mjcf: Path) -> RandomizedWorld:
    return RandomizedWorld(QUADRUPED_CFG, events("reset"), num_envs=N, mjcf=mjcf)


def test_constants_and_a_step_are_those_of_mujoco(world: RandomizedWorld, mjcf: Path):
    world.reset()
    world.reset(0, 2)
    constants_agree(world, mjcf)
    step_agrees(world, mjcf)
    model, _ = world.reference(mjcf, 0)
    built = mujoco.MjModel.from_xml_path(str(mjcf))
    assert np.abs(model.dof_invweight0 / built.dof_invweight0 - 1.0).max() > 0.1


def test_told_otherwise_the_solver_has_the_same_numbers(world: RandomizedWorld):
    world.reset()
    world.reset(1)
    mine = world.solver_model()
    world.sim.hooks, kept = [], world.sim.hooks
    flags = newton.ModelFlags.ALL
    world.sim.notify(flags)
    for name, values in world.solver_model().items():
        np.testing.assert_allclose(values, mine[name], rtol=3e-5, atol=1e-6 * np.abs(mine[name]).max(), err_msg=name)
    world.sim.hooks = kept
    world.sim.notify(flags)
    for name, values in world.solver_model().items():
        np.testing.assert_array_equal(values, mine[name], err_msg=name)


def test_at_startup_the_solver_is_told_as_a_whole(tmp_path: Path):
    mjcf = tmp_path / "model.xml"
    world = RandomizedWorld(QUADRUPED_CFG, events("startup"), num_envs=2, mjcf=mjcf)
    world.run("startup")
    assert not np.array_equal(*world.model("body_mass"))
    constants_agree(world, mjcf)


def test_what_the_launches_do_not_cover_goes_through_the_solver(tmp_path: Path):
    mjcf = tmp_path / "model.xml"
    solver = MuJoCoSolverCfg(kinematic_switchable_roots=True, save_to_mjcf=str(mjcf))
    mass = {k: v for k, v in events("reset").items() if k in ("mass", "com")}
    world = RandomizedWorld(QUADRUPED_CFG, mass, num_envs=2, solver=solver, ground=False)
    assert "in all worlds: bodies that may become kinematic" in [i.name for i in world.items("reset")][-1]
    world.reset()
    after = world.solver_model()
    for env in range(2):
        model, _ = world.reference(mjcf, env)
        np.testing.assert_allclose(after["dof_invweight0"][env], model.dof_invweight0, rtol=1e-4)
        np.testing.assert_allclose(after["body_invweight0"][env], model.body_invweight0, rtol=1e-4)
    world.reset(0)
    for name, values in world.solver_model().items():
        np.testing.assert_array_equal(values[1], after[name][1], err_msg=name)


def gravity(mode: str, size: float) -> EventTermCfg:
    bounds = [0.0, 0.0, -size]
    return event(
        mdp.randomize_physics_scene_gravity, mode, operation="abs", gravity_distribution_params=(bounds, bounds)
    )


def test_only_the_last_update_of_a_step_runs_beside_what_follows():
    terms = {"later": gravity("interval", 8.0), "first": gravity("reset", 9.0)}
    world = RandomizedWorld(CARTPOLE_CFG, terms, num_envs=2, ground=False)
    assert [world.items(mode)[-1].concurrent for mode in ("reset", "interval")] == [False, True]
    world.reset()
    np.testing.assert_array_equal(world.solver_model()["gravity"][:, 2], -9.0)
    for _ in range(3):  # the clock is drawn, then runs out
        world.run("interval")
    np.testing.assert_array_equal(world.solver_model()["gravity"][:, 2], -8.0)


def test_gains_and_limits_of_explicit_actuators_hold_in_the_next_step():
    pd = IdealPDActuatorCfg(joint_names_expr=[".*"], stiffness=10.0, damping=0.5, effort_limit=3.0)
    terms = {
        "gains": event(mdp.randomize_actuator_gains, stiffness_distribution_params=(0.5, 2.0),
                       damping_distribution_params=(0.5, 2.0), operation="scale"),
        "effort": event(mdp.randomize_effort_limits, effort_limit_range=(0.1, 0.4)),
    }  # fmt: skip
    world = RandomizedWorld(CARTPOLE_CFG.replace(actuators={"all": pd}), terms, num_envs=N, ground=False)
    world.reset()
    data = world.robot.data
    data.joint_pos_target[:], data.joint_vel[:] = 0.4, 0.1
    kp, kd, limit = (world.model(f"joint_{n}") for n in ("target_ke", "target_kd", "effort_limit"))
    asked = kp * (data.joint_pos_target - data.joint_pos).numpy() - kd * data.joint_vel.numpy()
    world.sim.step()
    np.testing.assert_allclose(data.computed_torque.numpy(), asked, rtol=1e-5)
    np.testing.assert_allclose(data.applied_torque.numpy(), np.clip(asked, -limit, limit), rtol=1e-5)
    assert (np.abs(asked) > limit).any()
    assert len(np.unique(kp)) == kp.size


def test_another_solver_moves_with_the_new_mass():
    mass = event(mdp.randomize_rigid_body_mass, mass_distribution_params=(2.0, 5.0), operation="scale")
    world = RandomizedWorld(CARTPOLE_CFG, {"mass": mass}, num_envs=2, solver=FeatherstoneSolverCfg(), ground=False)
    masses = world.default("body_mass")[0]
    assert "SolverFeatherstone tells no worlds apart" in world.items("reset")[-1].name
    world.reset(1)
    world.robot.data.joint_effort_target[:, 0] = 10.0
    world.robot.data.joint_pos[:] = 0.0
    world.sim.forward()
    world.sim.step()
    light, heavy = world.robot.data.joint_vel[:, 0].tolist()
    new = world.model("body_mass")[1]
    assert (new > 1.9 * masses).all()
    assert light > 1.5 * heavy > 0.0


ARM = """<mujoco><compiler angle="radian"/><worldbody><body name="base" pos="0 0 1"><freejoint/>
<geom type="box" size=".1 .1 .1" mass="2"/>
<body name="a" pos="0.1 0 0"><joint type="ball"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size=".03" mass="1"/>
<body name="b" pos="0.3 0 0"><joint name="hinge" axis="0 1 0" range="-1 1" armature="0.01"/>
<joint name="slide" type="slide" axis="1 0 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size=".03" mass="0.5"/>
</body></body><body name="c" pos="-0.1 0 0"><joint name="tail" axis="0 0 1"/>
<geom type="box" pos="-0.2 0 0" size=".1 .02 .03" mass="0.7"/></body></body></worldbody>
<actuator><general joint="tail" gainprm="30" biasprm="0 -30 1" biastype="affine"/></actuator></mujoco>"""


def test_all_kinds_of_joints_and_a_damping_ratio_follow_the_masses(tmp_path: Path):
    source, mjcf = tmp_path / "arm.xml", tmp_path / "model.xml"
    source.write_text(ARM)
    arm = ArticulationCfg(
        spawn=MjcfFileCfg(asset_path=str(source)), init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 1.0))
    )
    terms = {k: v for k, v in events("reset").items() if k in ("mass", "com")}
    terms["armature"] = event(mdp.randomize_joint_parameters, armature_distribution_params=(0.0, 0.05), operation="add")
    world = RandomizedWorld(arm, terms, num_envs=N, mjcf=mjcf, ground=False)
    assert "in all worlds" not in world.items("reset")[-1].name
    before = world.solver_model()
    world.reset(0, 2)
    mine = world.solver_model()
    for env in range(N):
        model, _ = world.reference(mjcf, env)
        for name in ("dof_invweight0", "body_invweight0", "body_subtreemass"):
            np.testing.assert_allclose(mine[name][env], getattr(model, name), rtol=1e-4, err_msg=name)
    for name, values in before.items():
        np.testing.assert_array_equal(mine[name][1], values[1], err_msg=name)
    world.sim.hooks = []
    world.sim.notify(newton.ModelFlags.ALL)
    damping = world.solver_model()["actuator_biasprm"][..., 2]
    np.testing.assert_allclose(mine["actuator_biasprm"][..., 2], damping, rtol=1e-5)
    assert len(np.unique(damping)) == N
