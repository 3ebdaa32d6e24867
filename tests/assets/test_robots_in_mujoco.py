# SPDX-License-Identifier: Apache-2.0
"""Robots of other projects' files, against MuJoCo's C engine."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import mujoco
import newton.examples
import numpy as np
import pytest
import torch

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg
from stripe_newton.sim import (
    MjcfFileCfg,
    MuJoCoSolverCfg,
    UrdfFileCfg,
)
from tests.helpers.small_scenes import DT, make_scene, numpy, sim_cfg

GYM = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
PASSIVE = {"all": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=0.0, damping=0.0)}


def c_engine(path: Path, contacts: bool = False) -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_path(str(path))
    if not contacts:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.timestep = DT
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON  # the humanoid's file asks for PGS, which Newton has not
    return model


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Names of the joints after the free root."""
    return [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) for j in range(1, model.njnt)]


@pytest.mark.filterwarnings("ignore::newton.NewtonWarning")
@pytest.mark.parametrize("name", ["ant", "humanoid"])
def test_mjcf_robot_moves_as_in_the_c_engine(name):
    path = GYM / f"{name}.xml"
    model = c_engine(path)
    data = mujoco.MjData(model)
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot",
        spawn=MjcfFileCfg(asset_path=str(path)),
        init_state=ArticulationCfg.InitialStateCfg(pos=tuple(model.qpos0[:3]), joint_pos=None),
    )
    scene = make_scene({"robot": robot})
    asset = scene.articulations["robot"]
    names = joint_names(model)
    assert sorted(asset.joint_names) == sorted(names)
    order = [names.index(n) for n in asset.joint_names]
    bodies = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, b) for b in range(1, model.nbody)]
    masses = dict(zip(asset.body_names, numpy(asset.data.body_mass)[0], strict=True))
    for body, mass in zip(bodies, model.body_mass[1:], strict=True):
        if body is not None:
            assert masses[body] == pytest.approx(mass, rel=1e-4), body
    assert sum(masses.values()) == pytest.approx(model.body_mass.sum(), rel=1e-4)
    limits = model.jnt_range[1:][order]
    limited = model.jnt_limited[1:][order].astype(bool)
    np.testing.assert_allclose(numpy(asset.data.joint_pos_limits)[0][limited], limits[limited], atol=1e-5)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(numpy(asset.data.joint_pos)[0], data.qpos[7:][order], atol=1e-6)
    torque = 0.3 * np.sin(np.arange(len(names)))
    data.qfrc_applied[6:] = torque
    asset.set_joint_effort_target(torch.tensor(torque[order], dtype=torch.float32).repeat(2, 1))
    for _ in range(3):
        mujoco.mj_step(model, data, 20)
        scene.sim.step(20)
        np.testing.assert_allclose(numpy(asset.data.joint_pos)[0], data.qpos[7:][order], atol=5e-3)
        np.testing.assert_allclose(numpy(asset.data.root_pos_w)[0], data.qpos[:3], atol=5e-3)
        np.testing.assert_allclose(numpy(asset.data.joint_vel)[0], data.qvel[6:][order], atol=8e-2)


def test_urdf_cartpole():
    path = newton.examples.get_asset("cartpole.urdf")
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot", spawn=UrdfFileCfg(asset_path=str(path), fix_base=True), actuators=PASSIVE
    )
    scene = make_scene({"robot": robot})
    asset = scene.articulations["robot"]
    assert asset.is_fixed_base
    assert asset.num_joints == len(asset.joint_names) >= 2
    model = mujoco.MjModel.from_xml_path(str(path))
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) for j in range(model.njnt)]
    assert asset.joint_names == names
    start = torch.linspace(0.1, 0.3, asset.num_joints).repeat(2, 1)
    asset.write_joint_state_to_sim(start, torch.zeros_like(start))
    model.opt.timestep, model.opt.integrator = DT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    data.qpos[:] = start[0].numpy()
    mujoco.mj_step(model, data, 100)
    scene.sim.step(100)
    np.testing.assert_allclose(numpy(asset.data.joint_pos)[0], data.qpos, atol=5e-3)


def test_urdf_quadruped_stands_on_its_drives():
    drives = {"legs": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=150.0, damping=5.0)}
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot",
        spawn=UrdfFileCfg(
            asset_path=str(newton.examples.get_asset("quadruped.urdf")), fix_base=False, self_collision=False
        ),
        init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 0.7)),
        actuators=drives,
    )
    from stripe_newton.assets import AssetBaseCfg
    from stripe_newton.sim import GroundPlaneCfg

    ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    scene = make_scene({"ground": ground, "robot": robot}, sim=sim_cfg(dt=0.004, solver=MuJoCoSolverCfg()))
    asset = scene.articulations["robot"]
    assert (asset.num_joints, asset.is_fixed_base) == (12, False)
    scene.sim.step(250)
    assert torch.isfinite(asset.data.root_state_w).all()
    assert 0.2 < float(asset.data.root_pos_w[0, 2]) < 0.8
    assert abs(float(asset.data.root_lin_vel_w[0, 2])) < 0.2
