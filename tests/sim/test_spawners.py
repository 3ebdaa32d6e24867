# SPDX-License-Identifier: Apache-2.0
"""Spawners: the prims that they author, and the behaviour of these prims."""

from __future__ import annotations

import math
from pathlib import Path

import newton
import numpy as np
import pytest
import torch
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdShade
from scipy.spatial.transform import Rotation

import stripe_newton.sim as sim_utils
from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import (
    CapsuleCfg,
    CollisionPropertiesCfg,
    ConeCfg,
    CuboidCfg,
    CylinderCfg,
    GroundPlaneCfg,
    MassPropertiesCfg,
    MeshCapsuleCfg,
    MeshConeCfg,
    MeshCuboidCfg,
    MeshCylinderCfg,
    MeshSphereCfg,
    MuJoCoSolverCfg,
    RigidBodyMaterialCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SphereCfg,
    UsdFileCfg,
)
from stripe_tasks.robots import CARTPOLE_CFG
from tests.helpers.small_scenes import DT, G, make_scene, numpy, sim_cfg

GROUND = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
SHAPES = {
    "cuboid": (CuboidCfg(size=(0.4, 0.3, 0.2)), 0.1),
    "sphere": (SphereCfg(radius=0.2), 0.2),
    "capsule": (CapsuleCfg(radius=0.1, height=0.4, axis="X"), 0.1),
    "cylinder": (CylinderCfg(radius=0.2, height=0.3), 0.15),
    "cone": (ConeCfg(radius=0.2, height=0.3), None),
    "mesh_cuboid": (MeshCuboidCfg(size=(0.4, 0.3, 0.2)), 0.1),
    "mesh_sphere": (MeshSphereCfg(radius=0.2), 0.2),
    "mesh_capsule": (MeshCapsuleCfg(radius=0.1, height=0.4, axis="X"), 0.1),
    "mesh_cylinder": (MeshCylinderCfg(radius=0.2, height=0.3), 0.15),
    "mesh_cone": (MeshConeCfg(radius=0.2, height=0.3), None),
}
"""Shapes, and how high their centres stand when they rest."""

PRIMITIVES = {"mesh_" + n: n for n in ("cuboid", "sphere", "capsule", "cylinder", "cone")}


def body(
    name: str, spawn, pos=(0.0, 0.0, 0.5), rot=(0.0, 0.0, 0.0, 1.0), mass: float | None = 1.0, mu=0.5
) -> RigidObjectCfg:
    spawn = spawn.replace(
        rigid_props=RigidBodyPropertiesCfg(),
        collision_props=CollisionPropertiesCfg(),
        mass_props=MassPropertiesCfg(mass=mass) if mass else None,
        physics_material=RigidBodyMaterialCfg(static_friction=mu, dynamic_friction=mu),
    )
    state = RigidObjectCfg.InitialStateCfg(pos=pos, rot=rot)
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=spawn, init_state=state)


@pytest.fixture(scope="module")
def shapes():
    """Every shape dropped from a little height, beside each other."""
    assets = {
        name: body(name, spawn, pos=(2.0 * i, 0.0, (rest or 0.15) + 0.02))
        for i, (name, (spawn, rest)) in enumerate(SHAPES.items())
    }
    return make_scene(
        {"ground": GROUND, **assets},
        num_envs=1,
        spacing=50.0,
        sim=sim_cfg(dt=0.004, solver=MuJoCoSolverCfg(nconmax=200, njmax=600)),
    )


def test_mesh_variants_have_the_inertia_of_the_primitives(shapes):
    for mesh, primitive in PRIMITIVES.items():
        one, two = (numpy(shapes[n].data.body_inertia)[0, 0] for n in (mesh, primitive))
        np.testing.assert_allclose(np.diag(one), np.diag(two), rtol=0.06, err_msg=mesh)
        np.testing.assert_allclose(
            numpy(shapes[mesh].data.root_com_offset_b), numpy(shapes[primitive].data.root_com_offset_b), atol=5e-3
        )


def test_inertia_of_the_primitives_is_the_textbooks(shapes):
    r, h = 0.2, 0.3
    expected = {
        "cuboid": np.array([0.3**2 + 0.2**2, 0.4**2 + 0.2**2, 0.4**2 + 0.3**2]) / 12,
        "sphere": np.full(3, 0.4 * 0.2**2),
        "cylinder": np.array([(3 * r**2 + h**2) / 12, (3 * r**2 + h**2) / 12, r**2 / 2]),
    }
    for name, inertia in expected.items():
        np.testing.assert_allclose(
            np.diag(numpy(shapes[name].data.body_inertia)[0, 0]), inertia, rtol=2e-3, err_msg=name
        )


def test_shapes_fall_and_rest_on_the_ground(shapes):
    names = [n for n, (_, rest) in SHAPES.items()]
    start = {n: float(shapes[n].data.root_pos_w[0, 2]) for n in names}
    shapes.sim.step(10)
    drop = 0.5 * G * (10 * 0.004) * (11 * 0.004)  # 9 mm: still in the air
    for name in names:
        assert start[name] - float(shapes[name].data.root_pos_w[0, 2]) == pytest.approx(drop, rel=0.02), name
    shapes.sim.step(140)
    for name, (_, rest) in SHAPES.items():
        data = shapes[name].data
        assert data.root_lin_vel_w[:, 2].abs().max() < 0.05, name
        if rest is not None:
            np.testing.assert_allclose(numpy(data.root_pos_w)[:, 2], rest, atol=1e-2, err_msg=name)
    for mesh, primitive in PRIMITIVES.items():
        assert float(shapes[mesh].data.root_pos_w[0, 2]) == pytest.approx(
            float(shapes[primitive].data.root_pos_w[0, 2]), abs=0.01
        )


def test_mass_by_density():
    scene = make_scene(
        {
            "own": body("Own", CuboidCfg(size=(0.5, 0.4, 0.3)).replace(), mass=None),
            "given": RigidObjectCfg(
                prim_path="{ENV_REGEX_NS}/Given",
                spawn=SphereCfg(
                    radius=0.2,
                    rigid_props=RigidBodyPropertiesCfg(),
                    collision_props=CollisionPropertiesCfg(),
                    mass_props=MassPropertiesCfg(density=300.0),
                ),
            ),
        }
    )
    assert float(scene["own"].data.body_mass[0, 0]) == pytest.approx(1000.0 * 0.5 * 0.4 * 0.3, rel=1e-4)
    assert float(scene["given"].data.body_mass[1, 0]) == pytest.approx(300.0 * 4 / 3 * math.pi * 0.2**3, rel=1e-4)


@pytest.mark.parametrize("cls", [CuboidCfg, MeshCuboidCfg])
def test_a_block_on_a_slope_sticks_or_slides_as_its_friction_says(cls):
    """Analytically: sticks if mu > tan(a), else slides with g (sin a - mu cos a)."""
    angle = math.radians(20.0)  # tan = 0.364
    turn = Rotation.from_euler("y", angle)
    slope = AssetBaseCfg(
        prim_path="/World/slope",
        spawn=CuboidCfg(
            size=(40.0, 40.0, 1.0),
            collision_props=CollisionPropertiesCfg(),
            physics_material=RigidBodyMaterialCfg(static_friction=0.05, dynamic_friction=0.05),
        ),
        init_state=AssetBaseCfg().init_state.replace(rot=tuple(turn.as_quat())),
    )

    def block(name: str, y: float, mu: float) -> RigidObjectCfg:
        spawn = cls(size=(0.4, 0.4, 0.1))
        return body(name, spawn, tuple(turn.apply([0.0, y, 0.55])), tuple(turn.as_quat()), mu=mu)

    sim = sim_cfg(solver=MuJoCoSolverCfg(cone="elliptic", impratio=10.0))
    scene = make_scene(
        {"slope": slope, "stick": block("Stick", -1.0, 0.6), "slide": block("Slide", 1.0, 0.15)}, spacing=0.0, sim=sim
    )
    scene.sim.step(50)
    before = {n: numpy(scene[n].data.root_lin_vel_w)[0] for n in ("stick", "slide")}
    scene.sim.step(200)
    downhill = turn.apply([1.0, 0.0, 0.0])
    gained = {n: float((numpy(scene[n].data.root_lin_vel_w)[0] - before[n]) @ downhill) for n in before}
    assert gained["stick"] == pytest.approx(0.0, abs=0.02)
    assert gained["slide"] == pytest.approx(G * (math.sin(angle) - 0.15 * math.cos(angle)) * 200 * DT, rel=0.03)


def test_a_static_collider_stops_a_ball_and_a_visual_shape_does_not():
    wall = {"size": (0.2, 2.0, 2.0)}
    state = AssetBaseCfg().init_state.replace(pos=(1.0, 0.0, 0.0))
    solid = AssetBaseCfg(
        prim_path="{ENV_REGEX_NS}/Solid",
        spawn=CuboidCfg(**wall, collision_props=CollisionPropertiesCfg()),
        init_state=state,
    )
    ghost = AssetBaseCfg(
        prim_path="{ENV_REGEX_NS}/Ghost", spawn=CuboidCfg(**wall), init_state=state.replace(pos=(1.0, 5.0, 0.0))
    )
    scene = make_scene(
        {
            "solid": solid,
            "ghost": ghost,
            "one": body("One", SphereCfg(radius=0.1), (0.0, 0.0, 0.0)),
            "two": body("Two", SphereCfg(radius=0.1), (0.0, 5.0, 0.0)),
        },
        sim=sim_cfg(solver=MuJoCoSolverCfg(), gravity=(0.0, 0.0, 0.0)),
    )
    for name in ("one", "two"):
        scene[name].write_root_velocity_to_sim(torch.tensor([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0]] * 2))
    scene.sim.step(400)
    x = [float(scene[n].data.root_pos_w[1, 0] - scene.env_origins[1, 0]) for n in ("one", "two")]
    assert x[0] < 0.82
    assert x[1] == pytest.approx(1.6, abs=0.01)


def test_environments_do_not_collide_with_each_other():
    """They stand on one spot, and fall as if alone."""
    scene = make_scene(
        {"ground": GROUND, "box": body("Box", CuboidCfg(size=(0.2, 0.2, 0.2)), (0.0, 0.0, 0.1))},
        num_envs=4,
        spacing=0.0,
        sim=sim_cfg(solver=MuJoCoSolverCfg()),
    )
    scene.sim.step(200)
    np.testing.assert_allclose(numpy(scene["box"].data.root_pos_w), [[0.0, 0.0, 0.1]] * 4, atol=3e-3)


def test_a_kinematic_or_disabled_body():
    spawn = CuboidCfg(
        size=(0.2, 0.2, 0.2), collision_props=CollisionPropertiesCfg(), mass_props=MassPropertiesCfg(mass=1.0)
    )
    fixed = AssetBaseCfg(
        prim_path="{ENV_REGEX_NS}/Off",
        spawn=spawn.replace(rigid_props=RigidBodyPropertiesCfg(rigid_body_enabled=False)),
    )
    scene = make_scene({"off": fixed, "box": body("Box", CuboidCfg(size=(0.1, 0.1, 0.1)), (3.0, 0.0, 1.0))})
    assert scene.sim.template.body_count == 1
    assert scene.sim.template.shape_count == 2


# -- what is authored


@pytest.fixture
def stage():
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=1.0), Simulation(sim_cfg()))
    with scene.construction():
        yield scene.stage


def test_shapes_are_proper_prims(stage):
    cfg = SHAPES["cylinder"][0].replace(
        rigid_props=RigidBodyPropertiesCfg(linear_damping=0.5, solver_position_iteration_count=8),
        collision_props=CollisionPropertiesCfg(contact_offset=0.02, rest_offset=0.0),
        mass_props=MassPropertiesCfg(mass=2.5),
        physics_material=RigidBodyMaterialCfg(dynamic_friction=0.8),
        visual_material=sim_utils.PreviewSurfaceCfg(diffuse_color=(0.9, 0.1, 0.2)),
        semantic_tags=[("class", "can"), ("class", "tin")],
        visible=False,
    )
    prim = cfg.func("/World/envs/env_.*/Can", cfg, translation=(1.0, 2.0, 3.0), orientation=(0.0, 0.6, 0.0, 0.8))
    geometry = stage.GetPrimAtPath("/World/envs/env_0/Can/geometry/mesh")
    assert prim.GetPath() == "/World/envs/env_0/Can"
    assert prim.HasAPI(UsdPhysics.RigidBodyAPI)
    assert UsdPhysics.MassAPI(prim).GetMassAttr().Get() == 2.5
    assert geometry.IsA(UsdGeom.Cylinder)
    assert geometry.HasAPI(UsdPhysics.CollisionAPI)
    assert geometry.GetAttribute("physxCollision:contactOffset").Get() == pytest.approx(0.02)
    assert prim.GetAttribute("physxRigidBody:linearDamping").Get() == 0.5
    assert prim.GetAttribute("physxRigidBody:solverPositionIterationCount").Get() == 8
    physics = UsdShade.MaterialBindingAPI(geometry).ComputeBoundMaterial("physics")[0].GetPrim()
    assert UsdPhysics.MaterialAPI(physics).GetDynamicFrictionAttr().Get() == pytest.approx(0.8)
    looks = UsdShade.MaterialBindingAPI(geometry).ComputeBoundMaterial()[0]
    assert tuple(looks.ComputeSurfaceSource()[0].GetInput("diffuseColor").Get()) == pytest.approx((0.9, 0.1, 0.2))
    world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)
    assert tuple(world.ExtractTranslation()) == (1.0, 2.0, 3.0)
    turned = world.TransformDir((1.0, 0.0, 0.0))
    np.testing.assert_allclose(
        tuple(turned), Rotation.from_quat([0.0, 0.6, 0.0, 0.8]).apply([1.0, 0.0, 0.0]), atol=1e-6
    )
    assert UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible
    assert list(prim.GetAttribute("semantics:labels:class").Get()) == ["can", "tin"]
    with pytest.raises(ValueError, match="a prim is there already"):
        cfg.func("/World/envs/env_.*/Can", cfg)


def test_ground_and_lights_are_proper_prims(stage):
    sim_utils.spawn_ground_plane("/World/ground", GroundPlaneCfg(), translation=(0.0, 0.0, -1.0))
    plane = UsdGeom.Plane(stage.GetPrimAtPath("/World/ground/CollisionPlane"))
    assert plane
    assert plane.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
    for cfg, kind in (
        (sim_utils.DomeLightCfg(intensity=3.0, color=(0.1, 0.2, 0.3)), UsdLux.DomeLight),
        (sim_utils.DistantLightCfg(angle=2.0, exposure=1.0), UsdLux.DistantLight),
        (sim_utils.SphereLightCfg(radius=0.7), UsdLux.SphereLight),
        (sim_utils.DiskLightCfg(radius=0.2), UsdLux.DiskLight),
        (sim_utils.CylinderLightCfg(length=3.0), UsdLux.CylinderLight),
    ):
        prim = cfg.func(f"/World/{type(cfg).__name__}", cfg)
        assert prim.IsA(kind)
        light = UsdLux.LightAPI(prim)
        assert light.GetIntensityAttr().Get() == cfg.intensity
        assert tuple(light.GetColorAttr().Get()) == pytest.approx(cfg.color)


def test_a_ground_plane_at_another_height():
    ground = GROUND.replace(init_state=AssetBaseCfg().init_state.replace(pos=(0.0, 0.0, -1.0)))
    scene = make_scene(
        {"ground": ground, "ball": body("Ball", SphereCfg(radius=0.2), (0.0, 0.0, -0.7))},
        sim=sim_cfg(solver=MuJoCoSolverCfg()),
    )
    scene.sim.step(300)
    assert float(scene["ball"].data.root_pos_w[0, 2]) == pytest.approx(-0.8, abs=5e-3)


def test_properties_of_a_usd_file():
    spawn = CARTPOLE_CFG.spawn.replace(
        articulation_props=sim_utils.ArticulationRootPropertiesCfg(enabled_self_collisions=False),
        joint_drive_props=sim_utils.JointDrivePropertiesCfg(
            stiffness=12.0, damping=3.0, max_effort=50.0, max_velocity=4.0
        ),
    )
    scene = make_scene({"robot": CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
    data = scene["robot"].data
    for field, value in (
        ("joint_stiffness", 12.0),
        ("joint_damping", 3.0),
        ("joint_effort_limits", 50.0),
        ("joint_vel_limits", 4.0),
    ):
        np.testing.assert_allclose(numpy(getattr(data, field)), value, rtol=1e-4, err_msg=field)


def test_scale_and_pose_of_a_usd_file():
    robots = {}
    for name, scale in (("one", None), ("two", (2.0, 2.0, 2.0))):
        cfg = CARTPOLE_CFG.replace(
            prim_path=f"{{ENV_REGEX_NS}}/{name.capitalize()}", spawn=CARTPOLE_CFG.spawn.replace(scale=scale)
        )
        robots[name] = cfg.replace(init_state=cfg.init_state.replace(pos=(0.0, 3.0 if scale else 0.0, 2.0)))
    scene = make_scene(robots)
    joints = torch.tensor([[0.0, 0.5]] * 2)
    ends = []
    for name in robots:
        robot = scene[name]
        robot.write_joint_position_to_sim(joints)
        scene.sim.forward()
        ends.append(numpy(robot.data.body_pos_w)[0] - numpy(robot.data.root_pos_w)[0])
    np.testing.assert_allclose(ends[1], 2.0 * ends[0], atol=1e-4)


def test_fix_root_link():
    ant = UsdFileCfg(
        usd_path=str(newton.examples.get_asset("ant.usda")),
        articulation_props=sim_utils.ArticulationRootPropertiesCfg(fix_root_link=True),
    )
    from stripe_tasks.robots import ANT_CFG

    cfg = ANT_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", spawn=ant)
    cfg = cfg.replace(init_state=cfg.init_state.replace(pos=(0.3, 0.4, 0.5), rot=(0.0, 0.0, 0.6, 0.8)))
    scene = make_scene({"robot": cfg})
    assert scene["robot"].is_fixed_base
    before = scene["robot"].data.root_pos_w.clone()
    np.testing.assert_allclose(numpy(before - scene.env_origins), [[0.3, 0.4, 0.5]] * 2, atol=1e-4)
    np.testing.assert_allclose(numpy(scene["robot"].data.root_quat_w), [[0.0, 0.0, 0.6, 0.8]] * 2, atol=1e-4)
    scene.sim.step(50)
    assert torch.equal(scene["robot"].data.root_pos_w, before)
    assert scene["robot"].data.joint_vel.abs().max() > 0.01


# -- errors


def test_errors_of_spawners(stage):
    cfg = UsdFileCfg(usd_path="nothing.usd")
    with pytest.raises(FileNotFoundError, match=r"usd_path 'nothing\.usd': does not exist"):
        cfg.func("/World/envs/env_.*/A", cfg)
    for cfg, field in (
        (SphereCfg(radius=-1.0), "radius"),
        (UsdFileCfg(usd_path=__file__, source_prim_path="--"), "source_prim_path"),
        (UsdFileCfg(usd_path=__file__, source_prim_path="Robot"), "source_prim_path"),
        (CapsuleCfg(radius=0.1, height=0.0), "height"),
        (SphereCfg(radius=1.0, mass_props=MassPropertiesCfg(mass=math.nan)), "mass_props.mass"),
        (SphereCfg(radius=1.0, physics_material=RigidBodyMaterialCfg(dynamic_friction=-1.0)), "dynamic_friction"),
        (
            SphereCfg(radius=1.0, collision_props=CollisionPropertiesCfg(contact_offset=0.0, rest_offset=1.0)),
            "contact_offset",
        ),
        (SphereCfg(), "radius: is missing"),
    ):
        with pytest.raises(ConfigError, match=field):
            RigidObjectCfg(prim_path="{ENV_REGEX_NS}/A", spawn=cfg).validate()


def pendulum_file(path: Path, metres: float, up: str = "Z") -> str:
    """A fixed base and a 2 kg bob on a hinge, in a file with the given units."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    length = 1.0 / metres
    robot = UsdGeom.Xform.Define(stage, "/robot").GetPrim()
    stage.SetDefaultPrim(robot)
    UsdPhysics.ArticulationRootAPI.Apply(robot)
    for name, height in (("base", 0.0), ("bob", -0.5)):
        body = UsdGeom.Xform.Define(stage, f"/robot/{name}")
        body.AddTranslateOp().Set(Gf.Vec3d(0.0, 0.0, height * length))
        UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
        UsdPhysics.MassAPI.Apply(body.GetPrim()).CreateMassAttr(2.0)
        shape = UsdGeom.Sphere.Define(stage, f"/robot/{name}/shape")
        shape.CreateRadiusAttr(0.1 * length)
        UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
    weld = UsdPhysics.FixedJoint.Define(stage, "/robot/weld")
    weld.CreateBody1Rel().SetTargets(["/robot/base"])
    hinge = UsdPhysics.RevoluteJoint.Define(stage, "/robot/hinge")
    hinge.CreateBody0Rel().SetTargets(["/robot/base"])
    hinge.CreateBody1Rel().SetTargets(["/robot/bob"])
    hinge.CreateAxisAttr("Y")
    hinge.CreateLocalPos1Attr(Gf.Vec3f(0.0, 0.0, 0.5 * length))
    stage.Save()
    return str(path)


def test_a_file_in_centimetres_is_converted(tmp_path):
    ends = {}
    for name, metres in (("metres", 1.0), ("centimetres", 0.01)):
        spawn = UsdFileCfg(usd_path=pendulum_file(tmp_path / f"{name}.usda", metres))
        cfg = ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn)
        robot = make_scene({"robot": cfg})["robot"]
        robot.write_joint_position_to_sim(torch.full_like(robot.data.joint_pos, 0.7))
        robot._sim.step(50)
        ends[name] = [numpy(robot.data.joint_pos), numpy(robot.data.body_pos_w), numpy(robot.data.body_inertia)]
        assert numpy(robot.data.body_mass)[0].tolist() == [2.0, 2.0]
    assert ends["metres"][0][0, 0] != pytest.approx(0.7)  # it swings
    for a, b in zip(*ends.values(), strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-4, atol=1e-6)


def test_a_file_with_another_up_axis_is_warned_of(tmp_path):
    cfg = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot", spawn=UsdFileCfg(usd_path=pendulum_file(tmp_path / "y.usda", 1.0, "Y"))
    )
    with pytest.warns(UserWarning, match="has the up axis Y"):
        make_scene({"robot": cfg})
