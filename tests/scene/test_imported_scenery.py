# SPDX-License-Identifier: Apache-2.0
"""Imported scenery: a stage that somebody else wrote is the world of a task, with places to start, scans, pictures."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade
from scipy.spatial.transform import Rotation

from stripe_kernels.terrain import TerrainData, ground_below, terrain_height, terrain_normal
from stripe_newton.assets import AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sensors import PinholeCameraCfg, TiledCameraCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    GroundPlaneCfg,
    MassPropertiesCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
    SphereCfg,
)
from stripe_newton.usd import StageError
from stripe_tasks.velocity import RoughSceneCfg
from stripe_tasks.velocity.quadruped import QuadrupedRoughEnvCfg
from tests.helpers.stage_triangles import ray_lengths, stage_triangles
from tests.helpers.usd_stages import add_body, new_stage
from tools.authoring.author_flat import GALLERY, author_flat

NUM_ENVS = 16


@pytest.fixture(scope="module")
def flat(tmp_path_factory) -> str:
    """A furnished flat of two storeys, with a ball and a carton that move."""
    return str(author_flat(tmp_path_factory.mktemp("flat") / "flat.usda", bodies=True))


@configclass
class BallSceneCfg(InteractiveSceneCfg):
    """A ball over a ground plane."""

    ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    ball: RigidObjectCfg = RigidObjectCfg(
        prim_path="{ENV_REGEX_NS}/Ball",
        spawn=SphereCfg(
            radius=0.1,
            rigid_props=RigidBodyPropertiesCfg(),
            mass_props=MassPropertiesCfg(mass=1.0),
            collision_props=CollisionPropertiesCfg(),
        ),
        init_state=RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 0.12)),
    )


def ball_scene(file: str, num_envs: int = 2, gravity: tuple = (0.0, 0.0, -9.81), **options: object) -> InteractiveScene:
    cfg = BallSceneCfg(num_envs=num_envs, env_spacing=2.0, scenery=file)
    for name, value in options.items():
        owner = cfg.scenery_options if hasattr(cfg.scenery_options, name) else cfg.scenery_options.start
        setattr(owner, name, value)
    scene = InteractiveScene(cfg, Simulation(SimulationCfg(device="cpu", dt=1 / 120, gravity=gravity)))
    scene.build()
    return scene


def box(stage: Usd.Stage, path: str, low: tuple, high: tuple, collides: bool = True, unit: float = 1.0) -> Usd.Prim:
    cube = UsdGeom.Cube.Define(stage, path)
    cube.CreateSizeAttr(1.0)
    cube.AddTranslateOp().Set(Gf.Vec3d(*(0.5 * (np.array(low) + high) / unit).tolist()))
    cube.AddScaleOp().Set(Gf.Vec3f(*((np.array(high) - low) / unit).tolist()))
    if collides:
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    return cube.GetPrim()


def write(stage: Usd.Stage, name: str) -> str:
    stage.GetRootLayer().Export(name)
    return name


@configclass
class ScanSceneCfg(RoughSceneCfg):
    """The scene of the rough task, with a camera on the robot."""

    eye: TiledCameraCfg = TiledCameraCfg(
        prim_path="{ENV_REGEX_NS}/Robot/base/eye",
        offset=TiledCameraCfg.OffsetCfg(pos=(0.3, 0.0, 0.1), convention="world"),
        spawn=PinholeCameraCfg(focal_length=24.0, horizontal_aperture=30.0, clipping_range=(0.01, 50.0)),
        width=16,
        height=12,
        data_types=["distance_to_camera", "semantic_segmentation"],
    )


@pytest.fixture(scope="module")
def env(flat) -> ManagerBasedRLEnv:
    cfg = QuadrupedRoughEnvCfg()
    cfg.scene = ScanSceneCfg(num_envs=NUM_ENVS, env_spacing=2.5, robot=cfg.scene.robot, scenery=flat)
    cfg.sim.device, cfg.seed, cfg.events.push_robot = "cpu", 4, None
    made = ManagerBasedRLEnv(cfg)
    yield made
    made.close()


def test_a_ball_dropped_at_each_place_rests_there(flat):
    scene = ball_scene(flat, 64)
    assert len(torch.unique(scene.env_origins, dim=0)) == 64
    assert "/World/ground/CollisionPlane" not in scene.sim.model.shape_label  # the flat has floors of its own
    for _ in range(6):
        scene.sim.step(10)
    rest = scene.rigid_objects["ball"].data.root_pos_w - scene.env_origins
    # On the edge of the rug, which is level enough, it rolls off: by 1 cm in height, and it stays in the clear.
    assert (rest[:, 2] - 0.1).abs().max() < 0.012
    assert torch.linalg.vector_norm(rest[:, :2], dim=1).max() < 0.15
    still = (rest - torch.tensor([0.0, 0.0, 0.1])).abs().amax(dim=1) < 2e-3
    assert still.sum() >= 60
    scene.close()


def test_the_quadruped_stands_at_its_places_for_a_second(env):
    env.reset()
    origins = env.scene.env_origins.clone()
    assert len(torch.unique(origins, dim=0)) > 10
    assert {0.0, 2.8} <= {round(z, 1) for z in origins[:, 2].tolist()}
    robot = env.scene["robot"].data
    torch.testing.assert_close(robot.root_pos_w[:, :2], origins[:, :2])
    for _ in range(50):
        _, _, terminated, truncated, _ = env.step(torch.zeros(NUM_ENVS, 12))
        assert not (terminated | truncated).any()
    height = robot.root_pos_w[:, 2] - origins[:, 2]
    assert height.min() > 0.25
    assert height.max() < 0.30
    assert robot.projected_gravity_b[:, 2].max() < -0.99


def test_scans_and_pictures_are_those_of_numpy(env, flat):
    env.reset(seed=2)
    corners, scanner, eye = stage_triangles(flat), env.scene["height_scanner"], env.scene["eye"]
    corners = np.concatenate([corners, _moving_corners(env)])
    hits = scanner.data.ray_hits_w.numpy().astype(float)
    for env_id in (0, 5, 9):
        starts = hits[env_id, ::3].copy()
        starts[:, 2] = float(scanner.data.pos_w[env_id, 2]) + 0.3
        lengths = ray_lengths(corners, starts, np.tile([0.0, 0.0, -1.0], (len(starts), 1)))
        ends = np.where(np.isfinite(hits[env_id, ::3, 2]), hits[env_id, ::3, 2], -np.inf)  # beyond the walls
        np.testing.assert_allclose(starts[:, 2] - ends, lengths, atol=1e-4)
    x, y, z, w = eye.data.quat_w_world[0].tolist()
    u, v = np.meshgrid(15.0 * (1.0 - (np.arange(16) + 0.5) / 8.0), 11.25 * (1.0 - (np.arange(12) + 0.5) / 6.0))
    rays = np.stack([np.full_like(u, 24.0), u, v], axis=-1).reshape(-1, 3)
    rays = Rotation.from_quat((x, y, z, w)).apply(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    lengths = ray_lengths(corners, np.tile(eye.data.pos_w[0].numpy().astype(float), (len(rays), 1)), rays)
    seen = eye.data.output["distance_to_camera"][0].numpy().reshape(-1)
    near = np.isfinite(lengths)
    # Where an edge lies in the pixel's middle, float32 may find the one side or the other.
    assert np.mean(np.abs(seen[near] - lengths[near]) < 1e-3 * np.maximum(1.0, lengths[near])) > 0.97
    labels = eye.data.info["semantic_segmentation"]["idToLabels"]
    assert {"floor", "wall", "table", "stairs"} <= set(map(str, labels.values()))


def _moving_corners(env: ManagerBasedRLEnv) -> np.ndarray:
    """Corners of the carton's triangles; the ball is far from what is compared."""
    index = [str(label).endswith("/carton") for label in env.sim.template.body_label].index(True)
    pose = env.sim.per_env(env.sim.state.body_q)[0, index].numpy()
    size = np.array((0.35, 0.4, 0.3))
    signs = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)]) * size + pose[:3]
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return signs[np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])]


def test_each_environment_has_copies_of_the_bodies_that_a_reset_puts_back(env):
    env.reset()
    bodies, labels = env.sim.per_env(env.sim.state.body_q), list(map(str, env.sim.template.body_label))
    carton = next(i for i, label in enumerate(labels) if label.endswith("/carton"))
    authored = torch.tensor([-0.725, -2.7, 0.15]).expand(NUM_ENVS, 3)
    torch.testing.assert_close(bodies[:, carton, :3], authored)
    joints = env.sim.per_env(env.sim.state.joint_q)
    joints[1:3, -7:-4] += 1.0  # the carton is the last body
    env.sim.forward()
    torch.testing.assert_close(bodies[1:3, carton, :3], authored[1:3] + 1.0)
    env.reset(options={"reset_mask": torch.arange(NUM_ENVS) == 1})
    torch.testing.assert_close(bodies[1, carton, :3], authored[1])
    torch.testing.assert_close(bodies[2, carton, :3], authored[2] + 1.0)
    env.step(torch.zeros(NUM_ENVS, 12))  # the solver goes on from there, too
    torch.testing.assert_close(bodies[1, carton, :3], authored[1], atol=2e-3, rtol=0.0)
    assert bodies[2, carton, 2] < 1.15  # in the air, where it falls


def test_an_episode_draws_another_place_and_a_saved_state_keeps_it(env):
    env.reset(seed=3)
    spots, first = env.scene.terrain.spots, env.scene.env_origins.clone()
    env.reset(options={"reset_mask": torch.arange(NUM_ENVS) < 8})
    moved = (env.scene.env_origins != first).any(dim=1)
    assert moved[:8].sum() >= 6
    assert not moved[8:].any()
    assert all((spots == origin).all(dim=1).any() for origin in env.scene.env_origins)
    state, here = env.get_state(), env.scene.env_origins.clone()
    env.reset()
    env.set_state(state)
    torch.testing.assert_close(env.scene.env_origins, here)
    env.reset(seed=3)
    torch.testing.assert_close(env.scene.env_origins, first)


@wp.kernel(enable_backward=False)
def look_up(terrain: TerrainData, points: wp.array[wp.vec3], out: wp.array2d[float]):
    i = wp.tid()
    p = points[i]
    out[i, 0] = ground_below(terrain, p)
    out[i, 1] = terrain_height(terrain, p[0], p[1])
    out[i, 2] = terrain_normal(terrain, p[0], p[1])[2]


def test_heights_are_those_of_the_storey_below(env, flat):
    points = np.array([[2.0, 0.5, 1.0], [2.0, 0.5, 3.0], [-2.6, -1.1, 0.5], [-2.6, -1.1, 1.5], [30.0, 0.0, 1.0]])
    out = wp.zeros((5, 3), dtype=float, device="cpu")
    inputs = [env.scene.terrain.struct, wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu")]
    wp.launch(look_up, dim=5, inputs=inputs, outputs=[out], device="cpu")
    found, bottom = out.numpy(), -0.2 - 1.0
    np.testing.assert_allclose(found[:, 0], [0.0, GALLERY, 0.0, 0.76, bottom], atol=1e-5)
    np.testing.assert_allclose(found[:, 1], [GALLERY, GALLERY, 0.76, 0.76, bottom], atol=1e-5)
    np.testing.assert_allclose(found[:, 2], 1.0, atol=1e-6)
    # An episode ends outside of the flat and below it, in the terms that the task has for falls and bounds.
    assert env.cfg.terminations.out_of_bounds.params == {"distance_buffer": 0.0}
    for place in ((30.0, 0.0, 1.0), (0.0, 0.0, -3.0)):
        env.reset()
        pose = env.scene["robot"].data.root_pose_w.clone()
        pose[3, :3] = torch.tensor(place)
        env.scene["robot"].write_root_pose_to_sim(pose)
        _, _, _, truncated, _ = env.step(torch.zeros(NUM_ENVS, 12))
        assert truncated.nonzero().flatten().tolist() == [3]


def test_describe_says_what_the_scenery_is(env):
    text = env.describe().split("scenery: ")[1].splitlines()[0]
    assert "81 shared colliders; 2 bodies in each environment; the task's ground is left out; 64 places" in text
    rows = [row for report in env.scene.builder.reports for row in report.ignored]
    assert any(row[0] == "/World/ground" and "is left out: the scenery has" in row[2] for row in rows)


def test_robots_of_different_environments_share_a_place_without_touching(flat):
    scene = ball_scene(flat, 3, num_spots=1)
    assert len(torch.unique(scene.env_origins, dim=0)) == 1
    for _ in range(3):
        scene.sim.step(10)
    rest = scene.rigid_objects["ball"].data.root_pos_w
    assert torch.equal(rest[0], rest[1])  # as if each were alone
    assert float((rest - scene.env_origins)[0].abs()[:2].max()) < 1e-4
    with pytest.raises(ValueError, match="has rigid bodies, of which each environment has copies"):
        scene.export("flat_out.usda")
    scene.close()


def test_furniture_alone_keeps_the_tasks_ground():
    stage = new_stage()
    for i in range(3):
        box(stage, f"/table_{i}", (2.0 * i, 0.0, 0.0), (2.0 * i + 1.0, 1.0, 0.7))
    scene = ball_scene(write(stage, "tables.usda"), 8)
    assert "the task's ground is kept" in scene.scenery.describe()
    assert any("CollisionPlane" in label for label in scene.sim.model.shape_label)
    origins = scene.env_origins.numpy()
    assert np.abs(origins[:, 2]).max() < 1e-6
    for i in range(3):  # beside the tables, as the ball needs 0.15 m
        beyond = np.maximum(np.abs(origins[:, :2] - (2.0 * i + 0.5, 0.5)) - 0.5, 0.0)
        assert np.linalg.norm(beyond, axis=1).min() > 0.14
    scene.export("scene.usda")
    again = InteractiveScene.from_usd("scene.usda", sim_cfg=SimulationCfg(device="cpu", dt=1 / 120))
    assert sum("table" in label for label in again.sim.model.shape_label) == 3
    scene.close()
    again.close()


def test_units_axes_pose_and_roots_beside_each_other_are_kept():
    """A room in centimetres with Y up, its material under another root prim, moved, turned and enlarged."""
    stage = new_stage(0.01, up="Y")
    floor = box(stage, "/Room/floor", (-3.0, -0.1, -2.0), (3.0, 0.0, 2.0), unit=0.01)
    box(stage, "/Room/post", (1.0, 0.0, 1.0), (1.2, 1.0, 1.2), unit=0.01)
    material = UsdShade.Material.Define(stage, "/Looks/ice")
    UsdPhysics.MaterialAPI.Apply(material.GetPrim()).CreateDynamicFrictionAttr(0.125)
    # Bound to the room: UsdPhysics by itself would read it on the floor alone.
    room = UsdShade.MaterialBindingAPI.Apply(floor.GetParent())
    room.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
    turn = Rotation.from_euler("z", 90, degrees=True).as_quat()
    scene = ball_scene(write(stage, "room.usda"), pos=(10.0, 0.0, 1.0), rot=tuple(turn.tolist()), scale=2.0)
    model, labels = scene.sim.model, [str(label) for label in scene.sim.model.shape_label]
    post = next(i for i, label in enumerate(labels) if label.endswith("/post"))
    # In metres with Z up the post is at (1.1, -1.1, 0.5); twice that, turned by 90 degrees, moved.
    np.testing.assert_allclose(model.shape_transform.numpy()[post, :3], (10.0 + 2.2, 2.2, 1.0 + 1.0), atol=1e-5)
    ice = next(i for i, label in enumerate(labels) if label.endswith("/floor"))
    assert model.shape_material_mu.numpy()[ice] == pytest.approx(0.125)
    np.testing.assert_allclose(scene.env_origins[:, 2], 1.0, atol=1e-5)
    scene.close()


def test_instancers_and_units_of_a_scenery_are_converted_with_a_row():
    """A floor in centimetres with posts and a ball that a point instancer places."""
    stage = new_stage(0.01)
    box(stage, "/Room/floor", (-3.0, -3.0, -0.1), (3.0, 3.0, 0.0), unit=0.01)
    posts = UsdGeom.PointInstancer.Define(stage, "/Room/posts")
    UsdGeom.XformCommonAPI(posts).SetTranslate(Gf.Vec3d(0.0, 100.0, 0.0))
    box(stage, "/Room/posts/kinds/post", (-0.1, -0.1, 0.0), (0.1, 0.1, 2.0), unit=0.01)
    add_body(stage, "/Room/posts/kinds/crate", (0.0, 0.0, 50.0))
    posts.CreatePrototypesRel().SetTargets(["/Room/posts/kinds/post", "/Room/posts/kinds/crate"])
    posts.CreateProtoIndicesAttr([0, 1, 0])
    posts.CreatePositionsAttr([(-200.0, 0.0, 0.0), (0.0, 0.0, 0.0), (200.0, -200.0, 0.0)])
    with pytest.warns(UserWarning, match=r"posts.usda: 2 things left out, converted or replaced") as shown:
        scene = ball_scene(write(stage, "posts.usda"))
    assert sum("posts.usda" in str(warning.message) for warning in shown) == 1
    model, labels = scene.sim.model, [str(label) for label in scene.sim.model.shape_label]
    shared = [i for i, label in enumerate(labels) if "posts_instances" in label and model.shape_body.numpy()[i] < 0]
    np.testing.assert_allclose(
        model.shape_transform.numpy()[shared, :3], [(-2.0, 1.0, 1.0), (2.0, -1.0, 1.0)], atol=1e-5
    )
    crate = next(i for i, label in enumerate(scene.sim.template.body_label) if "posts_instances" in str(label))
    np.testing.assert_allclose(
        scene.sim.per_env(scene.sim.state.body_q)[:, crate, :3], [(0.0, 1.0, 0.5)] * 2, atol=1e-5
    )
    (report,) = (r for r in scene.builder.reports if r.file == "posts.usda" and r.ignored)
    rows = {what: (where, why) for where, what, why in report.ignored}
    assert rows["units"][0] == scene.scenery.stage.path
    assert "converted to SI from 0.01 m" in rows["units"][1]
    assert rows["point instancer"][0] == f"{scene.scenery.stage.path}/Room/posts"
    assert "each of its 3 instances" in rows["point instancer"][1]
    scene.close()


def test_what_is_only_seen_collides_if_the_config_says_so():
    stage = new_stage()
    box(stage, "/floor", (-3.0, -3.0, -0.1), (3.0, 3.0, 0.0), collides=False)
    file = write(stage, "seen.usda")
    with pytest.raises(
        StageError, match=r"seen.usda: has no static collider: .* 1 have a shape; .*visuals_collide=True"
    ):
        ball_scene(file)
    scene = ball_scene(file, visuals_collide=True)
    assert "1 shared collider; the task's ground is left out" in scene.scenery.describe()
    scene.close()


def test_an_arena_of_mujoco_is_a_scenery(tmp_path):
    path = tmp_path / "arena.xml"
    floor, robot = '<geom type="box" size="3 3 .1" pos="0 0 .4"/>', '<body><freejoint/><geom size=".1"/></body>'
    path.write_text(f"<mujoco><worldbody>{floor}{robot}</worldbody></mujoco>")
    scene = ball_scene(str(path))
    assert "1 shared collider; the task's ground is left out" in scene.scenery.describe()
    np.testing.assert_allclose(scene.env_origins[:, 2].numpy(), 0.5, atol=1e-4)
    rows = [row[2] for report in scene.builder.reports for row in report.ignored]
    assert any("scenery of an MJCF file stands still" in row for row in rows)
    scene.close()
    path.with_suffix(".urdf").write_text("<robot name='a'><link name='a'/></robot>")
    with pytest.raises(StageError, match=r"is a URDF file; scenery is a USD or MJCF file, and a robot an asset"):
        ball_scene(str(path.with_suffix(".urdf")))


def test_errors_name_the_file_and_what_would_be_right(flat):
    def refused(words: str, **changes: object) -> None:
        cfg = BallSceneCfg(num_envs=2, env_spacing=2.0, **changes)
        with pytest.raises((ConfigError, StageError), match=words):
            InteractiveScene(cfg, Simulation(SimulationCfg(device="cpu"))).build()

    refused(r"scenery: 'none.usda': there is no such file; give a .usd, .usda", scenery="none.usda")
    stage = new_stage(0.0)
    box(stage, "/floor", (-3.0, -3.0, -0.1), (3.0, 3.0, 0.0))
    refused(r"units.usda: metersPerUnit is 0; it must be positive", scenery=write(stage, "units.usda"))
    stage = new_stage()
    box(stage, "/shelf", (0.0, 0.0, 0.0), (1.0, 1.0, 2.0))
    refused(r"shelf.usda: has no floor: .* and the task has no ground", scenery=write(stage, "shelf.usda"), ground=None)
    cfg = BallSceneCfg(num_envs=2, env_spacing=2.0, scenery=flat)
    cfg.scenery_options.ground, cfg.scenery_options.start.radius = "both", -1.0
    with pytest.raises(
        ConfigError, match=r"scenery_options.start.radius: is -1.0.*\n.*scenery_options.ground: is 'both'"
    ):
        cfg.validate()
    with pytest.raises(
        StageError, match=r"flat.usda: no places to start with 2.60 m around and .* too close to something"
    ):
        ball_scene(flat, radius=2.6)


def test_yaml_sets_a_scenery_and_a_fall_counts_from_its_storey(flat):
    from stripe_tasks.push_ball.manager_based import PushBallEnvCfg

    cfg = PushBallEnvCfg()
    cfg.from_dict({"scene": {"scenery": flat, "scenery_options": {"start": {"radius": 0.5, "lower": [0, 0, 1]}}}})
    assert cfg.scene.scenery_options.start.lower == (0, 0, 1)
    before = cfg.copy()
    before.scene.scenery = None
    before.complete()
    cfg.complete()
    falls = [[t.func for t in vars(c.terminations).values() if t is not None] for c in (before, cfg)]
    assert mdp.root_height_below_minimum in falls[0]
    assert mdp.root_height_over_ground_below_minimum in falls[1]
