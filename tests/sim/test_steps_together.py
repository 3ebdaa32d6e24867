# SPDX-License-Identifier: Apache-2.0
"""Physics steps in one launch, against a launch for each physics step and against MuJoCo Warp."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.actuators import DCMotorCfg, DelayedPDActuatorCfg
from stripe_newton.assets import AssetBaseCfg
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import GroundPlaneCfg, MuJoCoSolverCfg, mujoco_solver_cfg
from stripe_newton.sim.physics_step import PhysicsStep
from stripe_newton.solvers.step_kernel import StepKernel
from stripe_newton.solvers.support import why_slower
from tests.helpers.actuator_world import Drill, actuator_scene
from tests.helpers.small_scenes import make_scene, mjcf_robot, sim_cfg
from tests.helpers.solver_models import leave_curved_pairs

STEPS = 4
"""Physics steps of a step."""
ACROBAT = """<mujoco><worldbody><body name="trunk" pos="0 0 0.26"><freejoint/>
<inertial pos="0.05 0.02 -0.03" mass="3" diaginertia=".05 .06 .07"/>{geom}
<body name="leg" pos="0.2 0 0"><joint name="knee" axis="0 1 0" ref="20"/>
<inertial pos="0.1 0.03 -0.2" mass="1" diaginertia=".01 .012 .013"/>
<body name="foot" pos="0.1 0 -0.3"><joint name="toe" type="slide" axis="0 0 1"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia=".004 .005 .003"/></body></body>
<body name="head" pos="-0.2 0 0.1"><joint name="neck" type="ball"/>
<inertial pos="0.02 0 0.1" mass="0.6" diaginertia=".004 .005 .003"/></body>
</body></worldbody></mujoco>"""
MOTORS = {
    "motor": DCMotorCfg(
        joint_names_expr=["knee"], stiffness=20.0, damping=1.0, effort_limit=6.0, saturation_effort=9.0,
        velocity_limit=4.0,
    ),
    "late": DelayedPDActuatorCfg(
        joint_names_expr=["toe"], stiffness=30.0, damping=2.0, effort_limit=8.0, min_delay=1, max_delay=5,
    ),
}  # fmt: skip


@pytest.fixture
def launch_each_step(monkeypatch):
    """Makes simulations launch actuators, wrenches and limits in kernels of their own, around each physics step."""
    return lambda: monkeypatch.setattr(PhysicsStep, "in_solver", False)


def run(scene: InteractiveScene, count: int = 12) -> dict[str, np.ndarray]:
    """Take steps with changing targets, and return state, efforts and what actuators remember."""
    drill, sim = Drill(scene), scene.sim
    drill.state()
    sim.forward()
    for _ in range(count):
        drill.targets()
        sim.step(STEPS)
    state, actuation = sim.state, sim.actuation
    found = {n: getattr(state, n) for n in ("joint_q", "joint_qd", "body_q", "body_qd", "body_f")}
    found |= {n: getattr(actuation.drives, n) for n in ("effort", "computed_effort")}
    found |= actuation.arrays | {"previous_joint_qd": sim.previous_joint_qd}
    return {name: array.numpy().copy() for name, array in found.items() if array is not None}


def test_large_models_are_left_to_mujoco_warp_on_a_gpu_unless_asked_for(tmp_path, monkeypatch):
    assert why_slower(41, is_cuda=True) == "with 41 degrees of freedom, more than 40, MuJoCo Warp is faster on a GPU"
    assert not why_slower(40, is_cuda=True)
    assert not why_slower(64, is_cuda=False)
    asked = []
    monkeypatch.setattr(mujoco_solver_cfg, "why_slower", lambda *given: asked.append(given) or "it is large")
    ways = {f: actuator_scene(tmp_path, sim=sim_cfg(solver=MuJoCoSolverCfg(fused=f))) for f in (None, True)}
    assert ways[None].sim.describe_solver().endswith("does not support the model: it is large")
    assert ways[True].sim.describe_solver().startswith("the fused step")
    assert asked == [(ways[None].sim.model.joint_dof_count // ways[None].num_envs, False)]


def test_every_explicit_actuator_is_computed_in_the_launch(tmp_path, monkeypatch, launch_each_step):
    """The laws are one function in both ways, and nothing is converted: the same bits."""
    scene, launches, launch = actuator_scene(tmp_path), [], StepKernel.launch

    def count(kernel, arguments, worlds, device, steps=1, **kwargs):
        launches.append(steps)
        launch(kernel, arguments, worlds, device, steps, **kwargs)

    monkeypatch.setattr(StepKernel, "launch", count)
    found = run(scene)
    assert launches == [STEPS] * 12
    assert scene.sim.describe_solver().endswith("all physics steps of a step in one launch")
    warp = run(actuator_scene(tmp_path, sim=sim_cfg(solver=MuJoCoSolverCfg(disable_contacts=True, fused=False))))
    launch_each_step()
    each = run(actuator_scene(tmp_path))
    assert launches[12:] == [1] * 12 * STEPS
    assert {"integral", "pushes", "history", "lag"} <= set(found)
    assert all(np.abs(found[name]).max() > 0.0 for name in ("joint_qd", "effort", "integral", "history"))
    for name, want in each.items():
        np.testing.assert_array_equal(found[name], want, err_msg=name)
    for name, want in warp.items():
        np.testing.assert_allclose(found[name], want, atol=2e-5 * max(1.0, np.abs(want).max()), err_msg=name)


def acrobat(folder: Path, solver: MuJoCoSolverCfg, geom: str = "") -> InteractiveScene:
    """Floating robots with motors, wrenches in both frames, limits on all velocities and a torque on a ball joint."""
    robot = mjcf_robot(folder, ACROBAT.format(geom=geom), fix_base=False, actuators=MOTORS)
    ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    scene = make_scene({"ground": ground, "robot": robot}, num_envs=3, sim=sim_cfg(solver=solver))
    sim, rng = scene.sim, np.random.default_rng(0)
    sim.enable_external_wrench()
    sim.external_wrench.assign(rng.uniform(-2.0, 2.0, (sim.model.body_count, 6)).astype(np.float32))
    sim.wrench_in_world.assign(np.arange(sim.model.body_count) % 3 == 0)
    sim.limit_velocities()
    dofs = sim.model.joint_dof_count
    sim.velocity_limit.assign(rng.uniform(0.5, 3.0, dofs).astype(np.float32))
    wp.to_torch(sim.control.joint_act)[:] = torch.tensor(rng.uniform(-0.4, 0.4, dofs), dtype=torch.float32)
    return scene


def swing(scene: InteractiveScene) -> dict[str, np.ndarray]:
    sim, rng = scene.sim, np.random.default_rng(1)
    sim.state.joint_qd.assign(rng.uniform(-1.0, 1.0, sim.model.joint_dof_count).astype(np.float32))
    for _ in range(15):
        sim.control.joint_target_q.assign(rng.uniform(-0.5, 0.5, sim.control.joint_target_q.shape).astype(np.float32))
        sim.step(STEPS)
    state, drives = sim.state, sim.actuation.drives
    arrays = {n: getattr(state, n) for n in ("joint_q", "joint_qd", "body_q", "body_qd", "body_f")}
    arrays |= {"effort": drives.effort, "computed": drives.computed_effort, "before": sim.previous_joint_qd}
    return {name: array.numpy().copy() for name, array in arrays.items()}


@pytest.mark.parametrize("geom", ["", "<geom type='ellipsoid' size='.2 .3 .25'/>"], ids=["one", "each"])
def test_wrenches_limits_and_torques_of_balls_act_in_each_physics_step(tmp_path, launch_each_step, geom, monkeypatch):
    """Also where MuJoCo Warp's collision detection makes a launch of each physics step."""
    leave_curved_pairs(monkeypatch)
    solver = MuJoCoSolverCfg(njmax=60, nconmax=12) if geom else MuJoCoSolverCfg(disable_contacts=True)
    scene = acrobat(tmp_path, solver, geom)
    found = swing(scene)
    assert scene.sim.solver.one_launch == (not geom)
    if geom:
        assert scene.sim.solver.mjw_data.nefc.numpy().any()
    limits = np.abs(found["joint_qd"]) / scene.sim.velocity_limit.numpy()
    assert limits.max() <= 1.0 + 1e-5
    assert (limits > 0.999).sum() > 5
    launch_each_step()
    each = swing(acrobat(tmp_path, solver, geom))
    warp = swing(acrobat(tmp_path, solver.replace(fused=False), geom))
    for name, want in each.items():
        np.testing.assert_allclose(found[name], want, atol=1e-5, err_msg=name)
        np.testing.assert_allclose(found[name], warp[name], atol=2e-4, err_msg=name)
