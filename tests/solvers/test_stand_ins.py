# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for many static shapes: the same motion and contacts as with a geom for each of them."""

from pathlib import Path

import newton
import numpy as np
import pytest
import torch
import trimesh
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from stripe_newton.assets import AssetBaseCfg, RigidObjectCfg
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sensors import ContactSensorCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    MassPropertiesCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
    SphereCfg,
    UsdFileCfg,
)
from stripe_newton.solvers import stand_ins

SIDE = 17
"""Stones along each side of the floor."""


def write_floor(path: Path, shape: str | None, mesh_moves: bool = False) -> None:
    """Stones of two materials side by side, each its own convex mesh, and three things above them."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.Xform.Define(stage, "/World")
    UsdPhysics.Scene.Define(stage, "/World/physics")
    random, materials = np.random.default_rng(1), []
    for friction in (0.2, 0.9):
        material = UsdShade.Material.Define(stage, f"/World/material_{int(10 * friction)}")
        UsdPhysics.MaterialAPI.Apply(material.GetPrim()).CreateDynamicFrictionAttr(friction)
        materials.append(material)
    for k in range(SIDE * SIDE):
        box = trimesh.creation.box(random.uniform(0.21, 0.24, 3) * [1.0, 1.0, 0.5])
        mesh = define_mesh(stage, f"/World/stone_{k}", box.convex_hull)
        UsdGeom.XformCommonAPI(mesh).SetTranslate(Gf.Vec3d(0.2 * (k % SIDE), 0.2 * (k // SIDE), -0.06))
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(materials[k % 2], materialPurpose="physics")
    stage.SetDefaultPrim(stage.GetPrimAtPath("/World"))
    for k, at in enumerate(((1.0, 1.0), (1.5, 2.0), (2.3, 1.2)) if shape else ()):
        name = f"/World/thing_{k}"
        if mesh_moves:
            prim = define_mesh(stage, name, trimesh.creation.icosphere(subdivisions=1, radius=0.1)).GetPrim()
        else:
            prim = getattr(UsdGeom, shape).Define(stage, name).GetPrim()
            UsdGeom.XformCommonAPI(prim).SetScale(Gf.Vec3f(0.1, 0.1, 0.1))
            UsdPhysics.CollisionAPI.Apply(prim)
        UsdGeom.XformCommonAPI(prim).SetTranslate(Gf.Vec3d(*at, 0.2))
        UsdPhysics.RigidBodyAPI.Apply(prim).CreateVelocityAttr(Gf.Vec3f(0.6, 0.2 * k, 0.0))
    stage.GetRootLayer().Export(str(path))


def define_mesh(stage: Usd.Stage, path: str, hull: trimesh.Trimesh) -> UsdGeom.Mesh:
    """Add a mesh collider that is approximated by its hull."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(hull.vertices, dtype=np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(hull.faces))
    mesh.CreateFaceVertexIndicesAttr(hull.faces.reshape(-1).tolist())
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr("convexHull")
    return mesh


def path_of(file: Path, steps: int, **options: object) -> tuple[np.ndarray, InteractiveScene]:
    """Coordinates after each fifth step."""
    cfg = SimulationCfg(gravity=None, device="cpu", dt=1 / 240, **options)
    scene = InteractiveScene.from_usd(str(file), sim_cfg=cfg)
    path = []
    for _ in range(steps // 5):
        scene.sim.step(5)
        path.append(scene.sim.state.joint_q.numpy().copy())
    return np.array(path), scene


@pytest.mark.parametrize("shape", [pytest.param("Sphere", marks=pytest.mark.slow), "Cube"])
def test_motion_is_that_with_a_geom_for_each_shape(shape: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_floor(tmp_path / "floor.usda", shape)
    path, scene = path_of(tmp_path / "floor.usda", 150)
    solver = scene.sim.solver
    assert len(solver.hidden_shapes) == SIDE * SIDE - 2
    assert solver.mj_model.ngeom == 3 + 2  # one stone of each material
    monkeypatch.setattr(stand_ins, "_MANY", 10_000)
    with_geoms, other = path_of(tmp_path / "floor.usda", 150)
    assert other.sim.solver.mj_model.ngeom == 3 + SIDE * SIDE
    assert np.array_equal(path, with_geoms)
    assert (path[-1].reshape(3, 7)[:, 2] > 0.05).all()


def test_a_sensor_tells_hidden_shapes_apart(tmp_path: Path) -> None:
    write_floor(tmp_path / "floor.usda", None)
    below = SIDE * 5 + 6  # the stone at (1.2, 1.0), which is a hidden one
    ball = RigidObjectCfg(
        prim_path="{ENV_REGEX_NS}/Ball",
        spawn=SphereCfg(radius=0.1, mass_props=MassPropertiesCfg(mass=2.0), rigid_props=RigidBodyPropertiesCfg(),
                        collision_props=CollisionPropertiesCfg()),
    )  # fmt: skip
    stones = [f"/World/floor/stone_{k}" for k in (below, below + 2)]
    sensor = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Ball", filter_prim_paths_expr=stones)
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=2, env_spacing=0.0), Simulation(SimulationCfg(device="cpu")))
    floor = AssetBaseCfg(prim_path="/World/floor", spawn=UsdFileCfg(usd_path=str(tmp_path / "floor.usda")))
    scene.builder.build_objects({"floor": floor, "ball": ball})
    scene.builder.build_sensors({"touch": sensor})
    scene.build()
    assert below in scene.sim.solver.hidden_shapes - scene.sim.model.shape_label.index("/World/floor/stone_0")
    pose = torch.tensor([[1.2, 1.0, 0.1, 0.0, 0.0, 0.0, 1.0], [1.6, 1.0, 0.1, 0.0, 0.0, 0.0, 1.0]])
    scene["ball"].write_root_pose_to_sim(pose)
    for _ in range(60):
        scene.sim.step()
        scene.update(1 / 60)
    forces = scene.sensors["touch"].data.force_matrix_w[:, 0, :, 2]
    assert forces.numpy() == pytest.approx(2.0 * 9.81 * np.eye(2), rel=0.02, abs=1e-6)
    with pytest.raises(RuntimeError, match="ask for 'contact_f'"):
        scene.sim.solver.fill_contacts()
    check_changes_are_refused(scene, below)


def check_changes_are_refused(scene: InteractiveScene, stone: int) -> None:
    """Neither pose nor material of a stone may be changed: nobody would notice."""
    model, label = scene.sim.model, f"/World/floor/stone_{stone}"
    shape = model.shape_label.index(label)
    for name, what in (("shape_transform", "was moved"), ("shape_scale", "another size")):
        kept = getattr(model, name).numpy().copy()
        changed = kept.copy()
        changed[shape, 0] += 0.5
        getattr(model, name).assign(changed)
        with pytest.raises(ValueError, match=f"'{label}'.*{what}.*kinematicEnabled"):
            scene.sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)
        getattr(model, name).assign(kept)
    friction = model.shape_material_mu.numpy().copy()
    friction[shape] = 0.4
    model.shape_material_mu.assign(friction)
    with pytest.raises(ValueError, match=f"material of the static collider '{label}' was changed"):
        scene.sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)
    model.shape_material_mu.fill_(0.4)
    scene.sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)


def test_newton_finds_contacts_of_very_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes that move, which have no routine in the fused step, come to rest as on geoms."""
    write_floor(tmp_path / "floor.usda", "Sphere", mesh_moves=True)
    with_geoms, other = path_of(tmp_path / "floor.usda", 480)
    monkeypatch.setattr(stand_ins, "MOST_GEOMS", 100)
    monkeypatch.setattr("stripe_newton.sim.mujoco_solver_cfg.MOST_GEOMS", 100)
    path, scene = path_of(tmp_path / "floor.usda", 480)
    assert other.sim.pipeline is None
    assert scene.sim.pipeline is not None
    assert scene.sim.solver.mj_model.ngeom == 3 + 2
    assert f"because of {SIDE * SIDE - 2} static colliders" in scene.sim.describe_solver()
    heights = [p[-1].reshape(3, 7)[:, 2] for p in (path, with_geoms)]
    assert heights[0] == pytest.approx(heights[1], abs=5e-3)
