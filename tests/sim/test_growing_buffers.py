# SPDX-License-Identifier: Apache-2.0
"""Buffers that grow on the CPU: a heap that overflows them moves as it does with buffers that are large enough."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from stripe_newton.actuators import PIDActuatorCfg
from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sensors import ContactSensorCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    CuboidCfg,
    GroundPlaneCfg,
    MuJoCoSolverCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
)
from stripe_newton.sim.growing_buffers import GrowingBuffers
from tests.helpers.small_scenes import PENDULUM, mjcf_robot


def _heap(folder: Path, on_overflow: str = "grow", **solver: Any) -> InteractiveScene:
    """Five boxes in each of two environments, one thrown onto the others, beside a pendulum with an explicit drive."""
    cube = CuboidCfg(
        size=(0.2, 0.2, 0.2), rigid_props=RigidBodyPropertiesCfg(), collision_props=CollisionPropertiesCfg()
    )
    places = [(0.11, 0.11, 0.1), (-0.11, 0.11, 0.1), (0.11, -0.11, 0.1), (-0.11, -0.11, 0.1), (0.02, 0.01, 0.45)]
    boxes = {
        f"box{i}": RigidObjectCfg(
            prim_path=f"{{ENV_REGEX_NS}}/Box{i}",
            spawn=cube,
            init_state=RigidObjectCfg.InitialStateCfg(pos=place, lin_vel=(0.0, 0.0, -2.0 if i == 4 else 0.0)),
        )
        for i, place in enumerate(places)
    }
    drive = PIDActuatorCfg(
        joint_names_expr=[".*"], stiffness=20.0, damping=1.0, integral_gain=30.0, integral_limit=1.0, effort_limit=50.0
    )
    cfg = SimulationCfg(device="cpu", dt=1.0 / 120.0, solver=MuJoCoSolverCfg(**solver), on_overflow=on_overflow)
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=2, env_spacing=3.0), Simulation(cfg))
    scene.builder.build_objects({"ground": AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg()), **boxes})
    place = ArticulationCfg.InitialStateCfg(pos=(1.2, 0.0, 2.0), joint_pos={"hinge": 0.8})
    pendulum = mjcf_robot(folder, PENDULUM, prim_path="{ENV_REGEX_NS}/Pendulum", init_state=place)
    scene.builder.build_robot("pendulum", pendulum.replace(actuators={"pid": drive}))
    scene.builder.build_sensors({"touch": ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Box4")})
    scene.build()
    return scene


def _paths(scene: InteractiveScene) -> np.ndarray:
    """Coordinates, velocities and the forces on the thrown box after each step of two physics steps."""
    found = []
    for _ in range(30):
        scene.sim.step(2)
        scene.update(2.0 * scene.sim.physics_dt)
        state, forces = scene.sim.state, scene["touch"].data.net_forces_w
        found.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy(), forces.flatten().numpy()]))
    return np.stack(found)


@pytest.mark.parametrize("fused", [True, False], ids=["fused", "MuJoCo Warp"])
def test_a_heap_moves_as_it_does_with_large_buffers(fused, tmp_path):
    expected = _paths(_heap(tmp_path, "raise", fused=fused, njmax=1024, nconmax=256))
    scene = _heap(tmp_path, fused=fused, njmax=72, nconmax=16)
    with pytest.warns(UserWarning, match="the solver's buffers overflowed and grew") as told:
        found = _paths(scene)
    assert np.abs(found[:, -6:]).max() > 1.0  # the sensor has felt the box
    assert np.array_equal(found, expected)
    data = scene.sim.solver.mjw_data
    assert [str(warning.message) for warning in told] == [
        "the solver's buffers overflowed and grew, njmax from 72 to 144, nconmax from 16 to 32, and the step was done "
        "again; MuJoCoSolverCfg(njmax=144, nconmax=32) begins with that"
    ]
    assert (data.njmax, data.naconmax) == (144, 2 * 32)
    assert scene.sim.cfg.solver.njmax == 72  # the config stays the user's


def test_buffers_that_are_large_enough_do_not_grow(tmp_path):
    scene = _heap(tmp_path)
    sizes = scene.sim.solver.mjw_data.njmax, scene.sim.solver.mjw_data.naconmax
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        scene.sim.step()
    assert sizes == (scene.sim.solver.mjw_data.njmax, scene.sim.solver.mjw_data.naconmax)


def test_buffers_that_others_share_do_not_grow(tmp_path):
    scene = _heap(tmp_path, fused=False, njmax=72, use_mujoco_contacts=False)
    with pytest.raises(RuntimeError, match=r"njmax is 72, set MuJoCoSolverCfg\(njmax=144\)"):
        _paths(scene)


def test_the_reaction_is_one_of_three():
    with pytest.raises(ConfigError, match="is 'stop', must be 'grow', 'raise' or 'warn'"):
        Simulation(SimulationCfg(device="cpu", on_overflow="stop"))


def _stage_of_falling_boxes(folder: Path) -> Path:
    """Nine boxes above the ground: they touch nothing at the start, and after a fall of 0.3 s."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdPhysics.Scene.Define(stage, "/physics")
    ground = UsdGeom.Cube.Define(stage, "/ground")
    UsdGeom.XformCommonAPI(ground).SetTranslate(Gf.Vec3d(0.0, 0.0, -1.0))
    UsdGeom.XformCommonAPI(ground).SetScale(Gf.Vec3f(5.0, 5.0, 1.0))
    UsdPhysics.CollisionAPI.Apply(ground.GetPrim())
    for i in range(9):
        box = UsdGeom.Cube.Define(stage, f"/box_{i}")
        box.CreateSizeAttr(0.2)
        UsdGeom.XformCommonAPI(box).SetTranslate(Gf.Vec3d(0.3 * (i % 3), 0.3 * (i // 3), 0.5))
        for api in (UsdPhysics.CollisionAPI, UsdPhysics.RigidBodyAPI):
            api.Apply(box.GetPrim())
    stage.GetRootLayer().Export(str(folder / "boxes.usda"))
    return folder / "boxes.usda"


@pytest.mark.parametrize("newton_contacts", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_an_import_has_buffers_for_its_first_second_where_they_cannot_grow(newton_contacts, tmp_path, monkeypatch):
    """As on a GPU, and with Newton's collision detection: the trial leaves no trace but larger buffers."""
    monkeypatch.setattr(GrowingBuffers, "of", classmethod(lambda cls, sim: None))
    path = _stage_of_falling_boxes(tmp_path)
    contacts = False if newton_contacts else None

    def scene_of(on_overflow: str, njmax: int, nconmax: int) -> InteractiveScene:
        solver = MuJoCoSolverCfg(njmax=njmax, nconmax=nconmax, use_mujoco_contacts=contacts)
        cfg = SimulationCfg(device="cpu", gravity=None, dt=1 / 120, solver=solver, on_overflow=on_overflow)
        return InteractiveScene.from_usd(path, sim_cfg=cfg)

    with pytest.warns(UserWarning, match="too small for the first second and are made larger, njmax from 40 to"):
        scene = scene_of("grow", 40, 10)
    data = scene.sim.solver.mjw_data
    assert data.njmax >= 9 * 4 * 4
    assert f"{scene.sim.cfg.solver.njmax}" == f"{data.njmax}"
    large = scene_of("raise", data.njmax, scene.sim.cfg.solver.nconmax)
    for _ in range(10):
        scene.sim.step(12)
        large.sim.step(12)
        np.testing.assert_array_equal(scene.sim.state.joint_q.numpy(), large.sim.state.joint_q.numpy())
    small = scene_of("raise", 40, 10)
    with pytest.raises(RuntimeError, match="overflowed and dropped"):
        small.sim.step(60)
