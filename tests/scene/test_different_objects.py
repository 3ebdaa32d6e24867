# SPDX-License-Identifier: Apache-2.0
"""Environments that hold different rigid objects: each moves as one environment with its object alone does."""

from __future__ import annotations

import mujoco
import newton
import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import (
    CapsuleCfg,
    CollisionPropertiesCfg,
    CuboidCfg,
    CylinderCfg,
    GroundPlaneCfg,
    MassPropertiesCfg,
    MeshConeCfg,
    MeshCuboidCfg,
    MuJoCoSolverCfg,
    MultiAssetSpawnerCfg,
    MultiUsdFileCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
    SpawnerCfg,
    SphereCfg,
)
from stripe_newton.sim.model_update import ModelUpdate
from stripe_newton.viewers.display_model import DisplayModel

BODY = {"rigid_props": RigidBodyPropertiesCfg(), "collision_props": CollisionPropertiesCfg()}
OBJECTS: list[SpawnerCfg] = [
    CuboidCfg(size=(0.2, 0.3, 0.1), **BODY),
    SphereCfg(radius=0.12, mass_props=MassPropertiesCfg(mass=0.5), **BODY),
    CapsuleCfg(radius=0.08, height=0.2, **BODY),
    CuboidCfg(size=(0.1, 0.1, 0.25), **BODY),
    MeshConeCfg(radius=0.1, height=0.2, **BODY),
    MeshCuboidCfg(size=(0.2, 0.1, 0.15), **BODY),
    CylinderCfg(radius=0.1, height=0.2, **BODY),
]
STATIC = SphereCfg(radius=0.2, collision_props=CollisionPropertiesCfg())
DT, STEPS = 0.005, 120


def build(spawn: SpawnerCfg, num_envs: int, **solver: object) -> InteractiveScene:
    """A scene in which one object falls on a plane beside a ball that stands there."""

    @configclass
    class SceneCfg(InteractiveSceneCfg):
        ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
        ball = AssetBaseCfg(
            prim_path="{ENV_REGEX_NS}/Ball",
            spawn=STATIC,
            init_state=AssetBaseCfg().init_state.replace(pos=(0.25, 0.0, 0.05)),
        )
        thing = RigidObjectCfg(
            prim_path="{ENV_REGEX_NS}/Thing",
            spawn=spawn,
            init_state=RigidObjectCfg.InitialStateCfg(
                pos=(0.0, 0.0, 0.4), rot=(0.1, 0.2, 0.0, 0.9746794), ang_vel=(1.0, 0.5, 0.0)
            ),
        )

    settings = SimulationCfg(device="cpu", dt=DT, solver=MuJoCoSolverCfg(**solver))
    scene = InteractiveScene(SceneCfg(num_envs=num_envs, env_spacing=0.0), Simulation(settings))
    scene.build()
    return scene


def poses(scene: InteractiveScene, steps: int = STEPS) -> torch.Tensor:
    """Poses of the object after each step, shape ``(steps, num_envs, 7)``."""
    kept = []
    for _ in range(steps):
        scene.sim.step()
        kept.append(scene["thing"].data.root_pose_w.clone())
    return torch.stack(kept)


def poses_of_mujoco(scene: InteractiveScene) -> np.ndarray:
    """The same by MuJoCo's C library, of a scene with one environment that has not been stepped."""
    model = scene.sim.solver.mj_model
    data, kept = mujoco.MjData(model), []
    data.qpos[:] = scene.sim.solver.mjw_data.qpos.numpy()[0]
    data.qvel[:] = scene.sim.solver.mjw_data.qvel.numpy()[0]
    model.opt.timestep = DT
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
        kept.append(data.qpos[[0, 1, 2, 4, 5, 6, 3]].copy())
    return np.array(kept)


def in_turns(objects: list[SpawnerCfg]) -> MultiAssetSpawnerCfg:
    return MultiAssetSpawnerCfg(assets_cfg=objects, random_choice=False)


@pytest.fixture(scope="module")
def alone() -> list[tuple[torch.Tensor, np.ndarray]]:
    """Poses of each object alone in a scene, by MuJoCo Warp and by MuJoCo's C library."""
    found = []
    for spawn in OBJECTS:
        scene = build(spawn, 1, fused=False)
        by_c = poses_of_mujoco(scene)
        found.append((poses(scene)[:, 0], by_c))
    return found


@pytest.mark.parametrize("fused", [True, False])
def test_each_environment_moves_as_one_with_its_object_alone(fused: bool, alone) -> None:
    scene = build(in_turns(OBJECTS), len(OBJECTS) + 2, fused=fused)
    assert scene["thing"].asset_index.tolist() == [0, 1, 2, 3, 4, 5, 6, 0, 1]
    moved = poses(scene)
    for env, index in enumerate(scene["thing"].asset_index.tolist()):
        by_warp, by_c = alone[index]
        # A rolling capsule and edges of meshes have other contacts in MuJoCo's C library than in MuJoCo Warp.
        if fused:
            assert np.abs(moved[:, env].numpy() - by_c).max() < (1e-3 if index == 4 else 1e-4), index
        else:
            assert (moved[:, env] - by_warp).abs().max() < 1e-6, index


def test_absent_shapes_stay_absent_after_changes_and_with_newtons_contacts() -> None:
    at_rest = pytest.approx([0.05, 0.12], abs=2e-3)
    scene = build(in_turns(OBJECTS[:2]), 2, fused=False)
    scene.sim.notify(newton.ModelFlags.ALL)
    assert poses(scene, 300)[-1, :, 2].numpy() == at_rest
    update = ModelUpdate(scene.sim, ["shape_material_mu", "shape_transform"])
    update.launch(wp.ones(2, dtype=wp.bool, device="cpu"))
    assert poses(scene, 50)[-1, :, 2].numpy() == at_rest
    scene = build(in_turns(OBJECTS[:2]), 2, use_mujoco_contacts=False, fused=False)
    assert poses(scene, 300)[-1, :, 2].numpy() == at_rest


def test_the_draw_is_by_seed_and_not_by_the_number_of_environments() -> None:
    spawn = MultiAssetSpawnerCfg(assets_cfg=OBJECTS[:3], seed=3)
    assert (spawn.choices(100)[:7] == spawn.choices(7)).all()
    assert set(spawn.choices(100)) == {0, 1, 2}
    assert (spawn.choices(100) != spawn.replace(seed=4).choices(100)).any()
    scene = build(spawn, 6, fused=False)
    masses = scene.sim.model.body_mass.numpy()
    alone = [build(obj, 1, fused=False).sim.model.body_mass.numpy()[0] for obj in OBJECTS[:3]]
    assert masses == pytest.approx([alone[i] for i in scene["thing"].asset_index.tolist()])


def test_properties_override_those_of_the_assets_and_pictures_show_each_object() -> None:
    spawn = in_turns(OBJECTS[:3]).replace(mass_props=MassPropertiesCfg(mass=2.0), semantic_tags=[("class", "toy")])
    assert [asset.semantic_tags for asset in spawn.assets()] == [[("class", "toy")]] * 3
    scene = build(spawn, 3, fused=False)
    assert scene.sim.model.body_mass.numpy() == pytest.approx(2.0)
    shown = DisplayModel(scene.sim, [0, 1, 2]).model
    visible = (shown.shape_flags.numpy() & newton.ShapeFlags.VISIBLE != 0) & (shown.shape_body.numpy() >= 0)
    kinds = [newton.GeoType(kind).name for kind in shown.shape_type.numpy()[visible]]
    assert kinds == ["BOX", "SPHERE", "CAPSULE"]
    model = scene.sim.model  # as cameras and rays read it
    seen = (model.shape_flags.numpy() & newton.ShapeFlags.VISIBLE != 0) & (model.shape_body.numpy() >= 0)
    assert [newton.GeoType(kind).name for kind in model.shape_type.numpy()[seen]] == kinds


@pytest.mark.filterwarnings("ignore:.*left out, converted or replaced")
def test_files_take_turns_and_env_0_is_exported(tmp_path) -> None:
    files = []
    for index, radius in enumerate((0.1, 0.2)):
        path = tmp_path / f"ball_{index}.usda"
        path.write_text(
            f"""#usda 1.0
            (
                defaultPrim = "Ball"
                metersPerUnit = 1
                upAxis = "Z"
            )
            def Xform "Ball" ( prepend apiSchemas = ["PhysicsRigidBodyAPI"] )
            {{
                def Sphere "shape" ( prepend apiSchemas = ["PhysicsCollisionAPI"] )
                {{
                    double radius = {radius}
                }}
            }}"""
        )
        files.append(str(path))
    spawn = MultiUsdFileCfg(usd_path=files, random_choice=False, rigid_props=RigidBodyPropertiesCfg())
    scene = build(spawn, 4, fused=False)
    assert poses(scene, 400)[-1, :, 2].numpy() == pytest.approx([0.1, 0.2, 0.1, 0.2], abs=2e-3)
    scene.export(tmp_path / "scene.usda")
    again = InteractiveScene.from_usd(tmp_path / "scene.usda", sim_cfg=SimulationCfg(device="cpu"))
    assert again.sim.model.body_mass.numpy() == pytest.approx(scene.sim.model.body_mass.numpy()[:1])
    with pytest.raises(ConfigError, match=r"usd_path\[1\]: 'none.usd' does not exist"):
        MultiUsdFileCfg(usd_path=[files[0], "none.usd"]).validate()


def test_what_cannot_differ_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="asset 1: makes 0 bodies, must make one rigid body"):
        build(in_turns([OBJECTS[0], STATIC]), 2)
    with pytest.raises(ConfigError, match="assets_cfg: is empty, must have one asset or more"):
        in_turns([]).validate()
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=0.0), Simulation(SimulationCfg(device="cpu")))
    path = "{ENV_REGEX_NS}/Robot"
    scene.builder.build_robot("robot", ArticulationCfg(prim_path=path, spawn=in_turns(OBJECTS[:2]), actuators={}))
    with pytest.raises(ConfigError, match="environments can hold different rigid objects alone"):
        scene.build()
