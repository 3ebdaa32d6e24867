# SPDX-License-Identifier: Apache-2.0
"""Scenes: construction by fields and by hand, export and import, states, randomised dynamics, contacts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stripe_newton.actuators import IdealPDActuatorCfg, ImplicitActuatorCfg
from stripe_newton.assets import Articulation, ArticulationCfg, AssetBaseCfg, RigidObject, RigidObjectCfg
from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    CuboidCfg,
    DomeLightCfg,
    FeatherstoneSolverCfg,
    GroundPlaneCfg,
    MassPropertiesCfg,
    MuJoCoSolverCfg,
    RigidBodyMaterialCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
    SphereCfg,
    spawn_ground_plane,
)
from stripe_newton.terrains.spiral_grid import spiral_grid
from stripe_tasks.cart_double_pole import CartDoublePoleEnvCfg
from stripe_tasks.cartpole import CartpoleEnvCfg
from stripe_tasks.locomotion import AntEnvCfg, HumanoidEnvCfg
from stripe_tasks.robots import CARTPOLE_CFG
from tests.helpers.small_scenes import DT, MASS, G, make_scene, mjcf_robot, numpy, sim_cfg, sliders
from tools.checks.model_arrays import different_arrays

TASKS = {"cartpole": CartpoleEnvCfg, "double": CartDoublePoleEnvCfg, "ant": AntEnvCfg, "humanoid": HumanoidEnvCfg}
CONTACTS = MuJoCoSolverCfg()


def box(name: str = "Box", size: float = 0.4, mass: float = 3.0, z: float = 0.2, mu: float = 0.7) -> RigidObjectCfg:
    spawn = CuboidCfg(
        size=(size, size, size),
        rigid_props=RigidBodyPropertiesCfg(),
        mass_props=MassPropertiesCfg(mass=mass),
        collision_props=CollisionPropertiesCfg(),
        physics_material=RigidBodyMaterialCfg(static_friction=mu, dynamic_friction=mu),
    )
    state = RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, z))
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=spawn, init_state=state)


GROUND = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())


# -- construction


@configclass
class FieldsCfg(InteractiveSceneCfg):
    ground = GROUND
    robot: ArticulationCfg = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    cube = box()
    light = AssetBaseCfg(prim_path="/World/Light", spawn=DomeLightCfg(intensity=100.0))


def by_hand(path: str = "/World/envs/env_.*") -> InteractiveScene:
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=3, env_spacing=2.0), Simulation(sim_cfg()))
    with scene.construction():
        spawn_ground_plane(prim_path="/World/ground", cfg=GroundPlaneCfg())
        scene.articulations["robot"] = Articulation(CARTPOLE_CFG.replace(prim_path=f"{path}/Robot"))
        cube = box()
        scene.rigid_objects["cube"] = RigidObject(cube.replace(prim_path=f"{path}/Box"))
        scene.clone_environments(copy_from_source=False)
        light = DomeLightCfg(intensity=100.0)
        light.func("/World/Light", light)
    scene.filter_collisions(global_prim_paths=["/World/ground"])
    scene.build()
    return scene


def test_fields_and_hands_give_the_same_model():
    scene = InteractiveScene(FieldsCfg(num_envs=3, env_spacing=2.0), Simulation(sim_cfg()))
    scene.clone_environments()
    scene.build()
    assert scene.keys() == ["robot", "cube", "ground", "light"] == list(scene)
    assert scene["robot"] is scene.articulations["robot"]
    assert scene["cube"] is scene.rigid_objects["cube"]
    assert set(scene.extras) == {"ground", "light"}
    with pytest.raises(KeyError, match="no 'dog' in the scene; it has robot, cube, ground, light"):
        scene["dog"]
    for path in ("/World/envs/env_.*", "{ENV_REGEX_NS}", "/World/envs/env_0"):
        assert different_arrays(scene.sim.model, by_hand(path).sim.model) == []
    assert scene.num_envs == 3
    assert scene.env_prim_paths == [f"/World/envs/env_{i}" for i in range(3)]
    assert [light.kind for light in scene.sim.lights] == ["dome"]


def test_environments_stand_at_their_origins():
    scene = by_hand()
    np.testing.assert_array_equal(numpy(scene.env_origins), spiral_grid(3, 2.0))
    np.testing.assert_array_equal(scene.sim.env_origins, spiral_grid(3, 2.0))
    np.testing.assert_allclose(
        numpy(scene["cube"].data.root_pos_w - scene.env_origins), [[0.0, 0.0, 0.2]] * 3, atol=1e-6
    )
    np.testing.assert_allclose(
        numpy(scene["robot"].data.root_pos_w - scene.env_origins), [[0.0, 0.0, 2.0]] * 3, atol=1e-6
    )
    assert scene["cube"].data.default_root_state[:, :3].tolist() == [[0.0, 0.0, pytest.approx(0.2)]] * 3


def test_construction_errors():
    with pytest.raises(ValueError, match=r"two assets at '/World/envs/env_.*/Box'"):
        make_scene({"one": box(), "two": box().replace(prim_path="/World/envs/env_.*/Box", spawn=None)})
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=1.0), Simulation(sim_cfg()))
    scene.clone_environments()
    with pytest.raises(RuntimeError, match="comes after 'clone_environments' was called"):
        scene.builder.build_objects({"box": box()})
    scene = by_hand()
    with pytest.raises(RuntimeError, match="comes after the scene is built"):
        scene.builder.build_objects({"box": box("Other")})
    with pytest.raises(RuntimeError, match="no scene is under construction"):
        RigidObject(box())
    with pytest.raises(ValueError, match="filter_collisions: no prim at '/World/nothing'"):
        scene.filter_collisions(["/World/nothing"])
    with pytest.raises(ConfigError) as caught:
        InteractiveScene(InteractiveSceneCfg(num_envs=0, env_spacing=-1.0))
    assert len(caught.value.problems) == 2
    with pytest.raises(ConfigError, match="num_envs: is missing"):
        InteractiveScene(InteractiveSceneCfg())


def test_a_scene_of_static_things_alone():
    wall = AssetBaseCfg(
        prim_path="{ENV_REGEX_NS}/Wall", spawn=CuboidCfg(size=(1.0, 1.0, 1.0), collision_props=CollisionPropertiesCfg())
    )
    with pytest.raises(ValueError, match="no rigid body and no articulation"):
        make_scene({"ground": GROUND, "wall": wall})


def test_static_shapes_are_shared_and_those_of_environments_are_not():
    wall = AssetBaseCfg(
        prim_path="{ENV_REGEX_NS}/Wall",
        spawn=CuboidCfg(size=(1.0, 2.0, 3.0), collision_props=CollisionPropertiesCfg()),
        init_state=AssetBaseCfg().init_state.replace(pos=(0.5, 0.0, 1.0)),
    )
    scene = make_scene({"ground": GROUND, "wall": wall, "cube": box()}, num_envs=3)
    worlds = scene.sim.model.shape_world.numpy()
    assert sorted(worlds.tolist()) == [-1, 0, 0, 1, 1, 2, 2]
    poses = scene.sim.model.shape_transform.numpy()[(worlds >= 0) & (scene.sim.model.shape_body.numpy() < 0)]
    np.testing.assert_allclose(poses[:, :3] - numpy(scene.env_origins), [[0.5, 0.0, 1.0]] * 3, atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 9, 10, 50, 121])
def test_the_grid_is_a_spiral(count):
    grid = spiral_grid(count, 2.5)
    assert grid.shape == (count, 3)
    assert grid.dtype == np.float32
    np.testing.assert_array_equal(grid, spiral_grid(200, 2.5)[:count])
    assert not grid[0].any()
    apart = np.linalg.norm(grid[:, None] - grid[None], axis=-1) + 1e9 * np.eye(count)
    if count > 1:
        assert apart.min() == 2.5
        np.testing.assert_allclose(apart.min(1), 2.5)
        side = np.ceil(np.sqrt(count))
        assert np.abs(grid).max() <= 2.5 * np.ceil((side - 1) / 2) + 1e-6


# -- contacts


def test_a_resting_box_weighs_what_it_weighs():
    scene = make_scene({"ground": GROUND, "box": box()}, sim=sim_cfg(solver=CONTACTS, contact_forces=True))
    scene.sim.step(300)
    force = numpy(scene.querier.get_contact_forces("box"))
    np.testing.assert_allclose(force, [[[0.0, 0.0, 3.0 * G]]] * 2, atol=0.1)
    scene["box"].write_root_pose_to_sim(torch.tensor([[0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 1.0]]), [0])
    scene.sim.step(1)
    force = numpy(scene.querier.get_contact_forces("box"))
    np.testing.assert_allclose(force[0], 0.0, atol=1e-6)
    assert force[1, 0, 2] == pytest.approx(3.0 * G, rel=0.02)


def test_contact_forces_of_a_stack():
    scene = make_scene(
        {"ground": GROUND, "low": box("Low"), "high": box("High", size=0.2, mass=1.0, z=0.5)},
        sim=sim_cfg(solver=CONTACTS, contact_forces=True),
    )
    scene.sim.step(400)
    assert numpy(scene.querier.get_contact_forces("high"))[0, 0, 2] == pytest.approx(G, rel=0.03)
    assert numpy(scene.querier.get_contact_forces("low"))[0, 0, 2] == pytest.approx(3.0 * G, rel=0.03)


@pytest.mark.parametrize(
    "solver",
    [CONTACTS, pytest.param(MuJoCoSolverCfg(fused=False), marks=pytest.mark.slow)],
    ids=["fused", "MuJoCo Warp"],
)
def test_contact_forces_on_demand_are_those_that_are_exported_and_leave_no_trace(solver):
    objects = {"ground": GROUND, "low": box("Low"), "high": box("High", size=0.2, mass=1.0, z=0.5)}
    exported = make_scene(objects, sim=sim_cfg(solver=solver, contact_forces=True))
    asked, never = (make_scene(objects, sim=sim_cfg(solver=solver)) for _ in range(2))
    for _ in range(4):
        for scene in (exported, asked, never):
            scene.sim.step(100)
        force = numpy(asked.querier.get_contact_forces("low"))
        np.testing.assert_array_equal(asked.sim.state.joint_q.numpy(), never.sim.state.joint_q.numpy())
    np.testing.assert_allclose(force, numpy(exported.querier.get_contact_forces("low")), atol=0.05)
    np.testing.assert_allclose(force, [[[0.0, 0.0, 3.0 * G]]] * 2, atol=0.1)


def test_who_cannot_be_asked_is_said():
    scene = make_scene({"box": box()}, sim=sim_cfg(solver=FeatherstoneSolverCfg()))
    with pytest.raises(ValueError, match="does not report them"):
        scene.querier.get_contact_forces("box")
    with pytest.raises(ValueError, match="does not report them"):
        make_scene({"box": box()}, sim=sim_cfg(solver=FeatherstoneSolverCfg(), contact_forces=True))
    with pytest.raises(KeyError, match="no sensor 'imu'; the scene has none"):
        scene.querier.get_sensor_data("imu")
    with pytest.raises(KeyError, match="no articulation or rigid object 'dog'; the scene has box"):
        scene.querier.get_robot_state("dog")
    with pytest.raises(KeyError, match="the scene has no articulation; give the name of one asset"):
        scene.querier.get_robot_state()


# -- states


def test_reset_to_brings_a_state_back(tmp_path):
    robot = mjcf_robot(tmp_path, sliders({"x": "1 0 0", "z": "0 0 1"}))
    scene = make_scene({"robot": robot, "box": box(z=3.0)}, num_envs=3)
    scene["robot"].write_joint_state_to_sim(torch.rand(3, 2), torch.rand(3, 2))
    scene["box"].write_root_velocity_to_sim(torch.rand(3, 6))
    scene.sim.step(10)
    state = scene.get_state()
    assert state["articulation"]["robot"]["joint_position"].shape == (3, 2)
    assert state["rigid_object"]["box"]["root_pose"].shape == (3, 7)
    scene.sim.step(20)
    first = {k: v.clone() for k, v in scene.querier.get_robot_state("box").items()}
    joints = scene["robot"].data.joint_pos.clone()
    scene.reset_to(state)
    body = scene["box"].data.body_pos_w[:, 0].clone()
    assert torch.equal(body, state["rigid_object"]["box"]["root_pose"][:, :3])
    scene.sim.step(20)
    for key, value in scene.querier.get_robot_state("box").items():
        assert torch.equal(value, first[key]), key
    assert torch.equal(scene["robot"].data.joint_pos, joints)


def test_reset_to_of_some_environments_relative_to_their_origins():
    scene = make_scene({"box": box(z=3.0)}, num_envs=3)
    state = scene.get_state(is_relative=True)
    np.testing.assert_allclose(numpy(state["rigid_object"]["box"]["root_pose"])[:, :3], [[0, 0, 3.0]] * 3, atol=1e-6)
    scene.sim.step(20)
    fallen = scene["box"].data.root_pos_w.clone()
    rows = {"rigid_object": {"box": {k: v[[2]] for k, v in state["rigid_object"]["box"].items()}}}
    scene.reset_to(rows, env_ids=[2], is_relative=True)
    assert torch.equal(scene["box"].data.root_pos_w[:2], fallen[:2])
    np.testing.assert_allclose(numpy(scene["box"].data.root_pos_w[2] - scene.env_origins[2]), [0, 0, 3.0], atol=1e-6)


def test_controller_targets(tmp_path):
    scene = make_scene({"robot": mjcf_robot(tmp_path, sliders({"x": "1 0 0"}))})
    scene.controller.apply_actions({"robot": {"effort": torch.tensor([[1.0], [2.0]])}})
    scene.sim.step(10)
    speeds = scene["robot"].data.joint_vel[:, 0].tolist()
    assert speeds == pytest.approx([1.0 / MASS * 10 * DT, 2.0 / MASS * 10 * DT], rel=1e-5)
    with pytest.raises(KeyError, match="no articulation 'dog'; the scene has robot"):
        scene.controller.apply_actions({"dog": {}})
    with pytest.raises(KeyError, match="no target 'torque' of 'robot'"):
        scene.controller.apply_actions({"robot": {"torque": torch.zeros(2, 1)}})
    scene.controller.apply_actions(torch.tensor([[3.0], [4.0]]), kind="velocity")  # of the only articulation
    assert scene["robot"].data.joint_vel_target[:, 0].tolist() == [3.0, 4.0]
    with pytest.raises(ValueError, match="no event of the scene changes dynamics; give a range: mass_scale"):
        scene.controller.randomize_dynamics()


def test_parts_of_a_config_are_built_one_kind_at_a_time():
    @configclass
    class PartsCfg(InteractiveSceneCfg):
        robot: ArticulationCfg = CARTPOLE_CFG
        things: dict[str, AssetBaseCfg] = {"ground": GROUND, "red_box": box().replace(prim_path=MISSING)}

    scene = InteractiveScene(PartsCfg(num_envs=2, env_spacing=2.0), Simulation(sim_cfg()), author=False)
    assert scene.keys() == []
    assert list(scene.builder.build_objects()) == ["ground", "red_box"]
    assert list(scene.builder.build_robot()) == ["robot"]
    assert scene.builder.build_robot() == scene.builder.build_sensors() == {}  # nothing is left, or there is none
    assert scene.builder.build_terrain() is None
    scene.build()
    assert [a.path for a in scene.assets] == ["/World/ground", "/World/envs/env_0/RedBox", "/World/envs/env_0/Robot"]
    twice = PartsCfg(num_envs=1, env_spacing=0.0, things={"robot": GROUND})
    with pytest.raises(ValueError, match=r"scene\.robot: two parts have this name"):
        InteractiveScene(twice, Simulation(sim_cfg()))


# -- randomised dynamics


def test_randomised_dynamics_never_accumulate(tmp_path):
    drives = {"all": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=50.0, damping=4.0, armature=0.5)}
    scene = make_scene({"robot": mjcf_robot(tmp_path, sliders({"x": "1 0 0"}), actuators=drives)}, num_envs=8)
    data, generator = scene["robot"].data, torch.Generator().manual_seed(1)
    drawn = []
    for _ in range(5):
        scene.controller.randomize_dynamics(
            [1, 2, 3, 4, 5], mass_scale=(0.5, 1.5), stiffness_scale=(0.8, 1.2), damping_scale=(0.5, 0.6),
            armature_scale=(2.0, 3.0), generator=generator,
        )  # fmt: skip
        drawn.append(numpy(data.body_mass / data.default_mass))
        for field, default, (low, high) in (
            (data.body_mass, data.default_mass, (0.5, 1.5)),
            (data.joint_stiffness, 50.0, (0.8, 1.2)),
            (data.joint_damping, 4.0, (0.5, 0.6)),
            (data.joint_armature, 0.5, (2.0, 3.0)),
        ):
            ratio = numpy(field / default)
            assert ratio[1:6].min() >= low - 1e-5
            assert ratio[1:6].max() <= high + 1e-5
            np.testing.assert_array_equal(ratio[[0, 6, 7]], 1.0)
        inverse = scene.sim.model.body_inv_mass.numpy().reshape(8, -1)
        np.testing.assert_allclose(inverse * numpy(data.body_mass), 1.0, rtol=1e-5)
        inertia = data.body_inertia.numpy() @ scene.sim.model.body_inv_inertia.numpy().reshape(8, -1, 3, 3)
        np.testing.assert_allclose(inertia, np.broadcast_to(np.eye(3), inertia.shape), atol=1e-4)
    assert np.abs(np.diff(np.stack(drawn), axis=0))[:, 1:6].min() > 0.0  # drawn anew, body by body
    mean = np.stack(drawn)[:, 1:6].mean()
    assert mean == pytest.approx(1.0, abs=4 * 0.29 / np.sqrt(5 * 5 * 2))


def test_the_simulation_feels_randomised_masses_and_gains(tmp_path):
    drives = {"all": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=50.0, damping=0.0)}
    scene = make_scene({"robot": mjcf_robot(tmp_path, sliders({"x": "1 0 0"}), actuators=drives)}, num_envs=4)
    scene.sim.step(1)
    scene.controller.randomize_dynamics([1, 2], mass_scale=(2.0, 3.0))
    scene.controller.randomize_dynamics([2, 3], stiffness_scale=(0.2, 0.4))
    scene.controller.reset_robots()
    robot = scene["robot"]
    robot.set_joint_position_target(torch.full((4, 1), 1.0))
    scene.sim.step(1)
    mass, gain = numpy(robot.data.body_mass)[:, 1], numpy(robot.data.joint_stiffness)[:, 0]
    assert gain[1] == 50.0 != gain[2]
    np.testing.assert_allclose(numpy(robot.data.joint_vel)[:, 0], gain / mass * DT, rtol=1e-4)


def test_randomised_friction_decides_who_slides():
    scene = make_scene(
        {"ground": AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg(
            physics_material=RigidBodyMaterialCfg(static_friction=0.01, dynamic_friction=0.01))),
         "box": box(mu=0.5)},
        num_envs=3, sim=sim_cfg(solver=MuJoCoSolverCfg(cone="elliptic"), gravity=(3.0, 0.0, -9.0)),
    )  # fmt: skip
    scene.sim.step(50)
    scene.controller.randomize_dynamics([1], friction=(0.1, 0.1))
    ground = scene.sim.model.shape_material_mu.numpy()[0]
    assert ground == pytest.approx(0.01)
    before = numpy(scene["box"].data.root_lin_vel_w)[:, 0]
    scene.sim.step(100)
    gained = numpy(scene["box"].data.root_lin_vel_w)[:, 0] - before
    np.testing.assert_allclose(gained[[0, 2]], 0.0, atol=0.03)
    assert gained[1] == pytest.approx((3.0 - 0.1 * 9.0) * 100 * DT, rel=0.05)


@pytest.mark.parametrize("bounds", [(1.2, 0.8), (-0.5, 1.0)])
def test_ranges_are_checked(bounds):
    scene = make_scene({"box": box()})
    with pytest.raises(ValueError, match="mass_scale"):
        scene.controller.randomize_dynamics(mass_scale=bounds)


# -- export and import


def trip(scene: InteractiveScene, path, spacing: float = 3.0) -> InteractiveScene:
    """The scene exported and opened again with the same settings."""
    scene.export(path)
    again = InteractiveScene.from_usd(path, scene.num_envs, spacing, sim_cfg=scene.sim.cfg)
    assert different_arrays(scene.sim.model, again.sim.model) == []
    return again


def run_both(one: InteractiveScene, two: InteractiveScene, steps: int = 60) -> None:
    """Same trajectory, bit for bit."""
    start = one.sim.state.joint_q.numpy().copy()
    for scene in (one, two):
        scene.sim.state.joint_qd.fill_(0.1)
        scene.sim.step(steps)
    assert np.isfinite(one.sim.state.joint_q.numpy()).all()
    assert not np.array_equal(start, one.sim.state.joint_q.numpy())
    np.testing.assert_array_equal(one.sim.state.joint_q.numpy(), two.sim.state.joint_q.numpy())
    np.testing.assert_array_equal(one.sim.state.body_qd.numpy(), two.sim.state.body_qd.numpy())


@pytest.mark.parametrize("name", TASKS)
def test_the_scene_of_a_task_survives_a_round_trip(tmp_path, name):
    cfg = TASKS[name]()
    cfg.sim.device = "cpu"
    assets = {
        "robot": cfg.robot,
        "ground": AssetBaseCfg(prim_path="/World/ground", spawn=getattr(cfg, "ground", GroundPlaneCfg())),
    }
    scene = make_scene(assets, sim=cfg.sim)
    again = trip(scene, tmp_path / "scene.usda")
    assert list(again.articulations) == ["Robot"] or len(again.articulations) == 1
    found = next(iter(again.articulations.values()))
    assert found.joint_names == scene["robot"].joint_names
    assert torch.equal(found.data.default_joint_pos, scene["robot"].data.default_joint_pos)
    run_both(scene, again)


def test_explicit_actuators_bodies_and_materials_survive_a_round_trip(tmp_path):
    drives = {
        "cart": IdealPDActuatorCfg(joint_names_expr=["slider_to_cart"], stiffness=20.0, damping=2.0, effort_limit=30.0),
        "pole": ImplicitActuatorCfg(
            joint_names_expr=["cart_to_pole"], stiffness=1.0, damping=0.1, armature=0.02, friction=0.01
        ),
    }
    state = ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 2.0), joint_pos={"slider_to_cart": 0.3, "cart_to_pole": 0.2})
    robot = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", actuators=drives, init_state=state)
    ball = RigidObjectCfg(
        prim_path="{ENV_REGEX_NS}/Ball",
        spawn=SphereCfg(
            radius=0.1, rigid_props=RigidBodyPropertiesCfg(), collision_props=CollisionPropertiesCfg(),
            mass_props=MassPropertiesCfg(density=300.0), physics_material=RigidBodyMaterialCfg(dynamic_friction=0.9),
        ),
        init_state=RigidObjectCfg.InitialStateCfg(pos=(1.0, 0.0, 0.5), rot=(0.0, 0.6, 0.0, 0.8)),
    )  # fmt: skip
    material = RigidBodyMaterialCfg(static_friction=0.3, dynamic_friction=0.3, density=700.0)
    bare = CuboidCfg(
        size=(0.1, 0.2, 0.3), rigid_props=RigidBodyPropertiesCfg(), collision_props=CollisionPropertiesCfg()
    )
    light = RigidObjectCfg(
        prim_path="{ENV_REGEX_NS}/Light", spawn=bare, init_state=ball.init_state.replace(pos=(3.0, 0.0, 2.0))
    )
    scene = make_scene(
        {"ground": GROUND, "robot": robot, "ball": ball, "light": light, "box": box(mu=0.15, z=0.25)},
        sim=sim_cfg(solver=CONTACTS, physics_material=material),
    )
    again = trip(scene, tmp_path / "scene.usda")
    assert len(again.rigid_objects) == 3
    assert float(again["Light"].data.body_mass[0, 0]) == pytest.approx(700.0 * 0.1 * 0.2 * 0.3, rel=1e-5)
    plain = InteractiveScene.from_usd(tmp_path / "scene.usda", 2, 3.0, SimulationCfg(device="cpu", gravity=None))
    np.testing.assert_array_equal(plain.sim.model.body_mass.numpy(), scene.sim.model.body_mass.numpy())
    assert (
        sum(a.num_actuators for a in again.sim.model.actuators)
        == sum(a.num_actuators for a in scene.sim.model.actuators)
        == 2
    )
    run_both(scene, again, 100)


def test_gravity_and_lights_survive_a_round_trip(tmp_path):
    def author(scene: InteractiveScene) -> None:
        light = DomeLightCfg(intensity=321.0, color=(0.2, 0.4, 0.6))
        light.func("/World/Light", light)

    scene = make_scene({"box": box(z=2.0)}, sim=sim_cfg(gravity=(0.5, 0.0, -3.0)), author=author)
    path = tmp_path / "scene.usda"
    scene.export(path)
    again = InteractiveScene.from_usd(path, 2, 3.0, SimulationCfg(device="cpu", gravity=None, dt=DT))
    np.testing.assert_allclose(again.sim.model.gravity.numpy(), scene.sim.model.gravity.numpy(), rtol=1e-6)
    assert again.sim.lights[0].intensity == 321.0
    assert again.sim.lights[0].color == pytest.approx((0.2, 0.4, 0.6))


def test_a_scene_with_another_number_of_environments(tmp_path):
    scene = make_scene({"box": box(z=2.0)})
    path = tmp_path / "scene.usda"
    scene.export(path)
    again = InteractiveScene.from_usd(path, 5, 1.0, scene.sim.cfg)
    assert again.num_envs == 5
    np.testing.assert_allclose(
        numpy(again["Box"].data.root_pos_w - again.env_origins), [[0.0, 0.0, 2.0]] * 5, atol=1e-6
    )


def test_export_needs_a_built_scene(tmp_path):
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=1.0), Simulation(sim_cfg()))
    with pytest.raises(RuntimeError, match="not built"):
        scene.export(tmp_path / "scene.usda")
