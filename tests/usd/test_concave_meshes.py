# SPDX-License-Identifier: Apache-2.0
"""Concave meshes: which meshes are not their convex hull, and what an import says of them."""

import newton
import numpy as np
import pytest
from newton.examples import get_asset
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from stripe_newton.assets import ArticulationCfg
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import MjcfFileCfg, MuJoCoSolverCfg, Simulation, SimulationCfg
from stripe_newton.usd import load_stage
from stripe_newton.usd.concave_meshes import hollow_depth
from tests.helpers.usd_stages import new_stage

BOX_FACES = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5],
                      [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]])  # fmt: skip
BOX = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], dtype=float)

STEP = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)


def prism(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A closed prism over an outline that can be seen whole from its first point."""
    n = len(outline)
    points = np.concatenate([np.c_[outline, np.zeros(n)], np.c_[outline, np.ones(n)]])
    caps = [[0, i + 1, i] for i in range(1, n - 1)] + [[n, n + i, n + i + 1] for i in range(1, n - 1)]
    sides = [f for i in range(n) for f in ([i, (i + 1) % n, n + i], [(i + 1) % n, n + (i + 1) % n, n + i])]
    return points, np.array(caps + sides)


def test_a_box_and_a_sphere_are_their_hulls():
    sphere = newton.Mesh.create_sphere(0.5, num_latitudes=24, num_longitudes=24)
    assert hollow_depth(BOX, BOX_FACES) is None
    assert hollow_depth(np.array(sphere.vertices), np.array(sphere.indices).reshape(-1, 3)) is None


def test_points_that_are_repeated_do_not_open_a_mesh():
    faces = np.arange(36).reshape(12, 3)
    assert hollow_depth(BOX[BOX_FACES.reshape(-1)], faces) is None


def test_a_corner_is_as_deep_as_it_is():
    # Of two arms of 2 and a thickness of 1 the corner is 1 from each outer face; the extent is 3.
    points, faces = prism(STEP)
    assert hollow_depth(points, faces) == pytest.approx(1.0 / 3.0)


def test_a_bevel_is_no_hollow():
    # 0.5 % of the extent
    points, faces = prism(np.array([[0, 0], [2, 0], [2, 1], [1.0, 0.99], [0, 1]], dtype=float))
    assert hollow_depth(points, faces) is None


def test_a_box_without_a_lid_is_open():
    assert hollow_depth(BOX, BOX_FACES[[0, 1, *range(4, 12)]]) == 0.0


def add_step(stage: Usd.Stage, path: str, approximation: str | None) -> None:
    """A step of two by two metres, one deep, its tread at a height of one; no collider if ``approximation`` is ''."""
    points, faces = prism(STEP)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([Gf.Vec3f(float(x), -float(z), float(y)) for x, y, z in points])
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.reshape(-1).tolist())
    if approximation != "":
        UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    if approximation:
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(approximation)


def drop_a_ball(
    approximation: str | None, solver: MuJoCoSolverCfg, steps: int = 200, shape: type = UsdGeom.Sphere
) -> tuple[InteractiveScene, np.ndarray]:
    """The scene, and where a ball of 0.2 m is that falls onto the tread of the step."""
    stage = new_stage()
    add_step(stage, "/World/step", approximation)
    ball = shape.Define(stage, "/World/ball")
    ball.CreateRadiusAttr(0.2)
    if shape is UsdGeom.Cylinder:
        ball.CreateHeightAttr(0.4)
    UsdGeom.XformCommonAPI(ball).SetTranslate(Gf.Vec3d(1.5, -0.5, 1.3))
    UsdPhysics.RigidBodyAPI.Apply(ball.GetPrim())
    UsdPhysics.CollisionAPI.Apply(ball.GetPrim())
    scene = InteractiveScene.from_usd(stage, sim_cfg=SimulationCfg(dt=0.005, device="cpu", solver=solver))
    scene.sim.step(steps)
    return scene, scene.sim.state.body_q.numpy()[0, :3]


def test_a_ball_rests_on_the_tread():
    scene, place = drop_a_ball(None, MuJoCoSolverCfg())
    assert place == pytest.approx([1.5, -0.5, 1.2], abs=1e-3)
    rows = [row for row in scene.builder.reports[0].ignored if row[1] == "concave mesh collider"]
    assert [row[2] for row in rows] == ["it has hollows: its triangles collide"]


def test_the_fused_step_takes_newton_s_contacts_as_mujoco_warp_does():
    places = []
    for fused in (None, False):
        solver = MuJoCoSolverCfg(fused=fused, use_mujoco_contacts=False)
        scene, _ = drop_a_ball(None, solver, steps=60)  # it has touched after 28
        places.append(scene.sim.state.body_q.numpy()[0])
        if fused is None:
            assert scene.sim.describe_solver() == "the fused step, with Newton's collision detection for all contacts"
    np.testing.assert_allclose(*places, atol=2e-5)


@pytest.mark.parametrize(("rows", "lid"), [(12, False), (10, True)])
def test_a_hull_that_a_stage_asks_for_has_a_row_if_it_fills_hollows_or_openings(rows: int, lid: bool) -> None:
    stage = new_stage()
    add_step(stage, "/World/step", "convexHull")
    box = UsdGeom.Mesh.Define(stage, "/World/box")
    box.CreatePointsAttr(BOX.tolist())
    box.CreateFaceVertexCountsAttr([3] * rows)
    box.CreateFaceVertexIndicesAttr(BOX_FACES[:rows].reshape(-1).tolist())
    UsdPhysics.CollisionAPI.Apply(box.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(box.GetPrim()).CreateApproximationAttr("convexHull")
    report = load_stage(newton.ModelBuilder(), stage)
    found = {path for path, what, _ in report.ignored if what == "convex hull of a concave mesh"}
    assert found == ({"/World/step", "/World/box"} if lid else {"/World/step"})


def test_a_config_may_ask_for_the_hull():
    scene, place = drop_a_ball(None, MuJoCoSolverCfg(use_mujoco_contacts=True))
    assert place[0] > 1.7  # off the slope of the hull
    assert "its convex hull collides, but" in next(r for r in scene.builder.reports[0].ignored if "concave" in r[1])[2]


@pytest.mark.parametrize("mujoco_contacts", [None, False])
def test_a_mesh_of_a_robot_s_file_means_its_hull(mujoco_contacts, tmp_path):
    points, faces = prism(STEP)
    lines = ["o step", *(f"v {x} {y} {z}" for x, y, z in points), *(f"f {a} {b} {c}" for a, b, c in faces + 1)]
    (tmp_path / "step.obj").write_text("\n".join(lines))
    file = tmp_path / "table.xml"
    file.write_text(
        "<mujoco><asset><mesh name='step' file='step.obj'/></asset><worldbody><geom type='mesh' mesh='step'/>"
        "<body name='ball' pos='1.2 1.2 1.12'><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    cfg = SimulationCfg(device="cpu", solver=MuJoCoSolverCfg(use_mujoco_contacts=mujoco_contacts))
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=4.0), Simulation(cfg))
    start = ArticulationCfg.InitialStateCfg(pos=None, joint_pos=None)
    spawn = MjcfFileCfg(asset_path=str(file))
    robot = ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={}, init_state=start)
    scene.builder.build_robot("robot", robot)
    scene.build()
    assert (scene.sim.pipeline is None) == (mujoco_contacts is None)
    scene.sim.step(60)
    # In the notch of the step, which the hull closes.
    assert scene.sim.state.body_q.numpy()[0, :3] == pytest.approx([1.2, 1.2, 1.1], abs=2e-3)


def test_newton_finds_the_contacts_that_the_kernel_has_no_routine_for():
    solver = MuJoCoSolverCfg()
    scene, place = drop_a_ball(None, solver, shape=UsdGeom.Cylinder)
    assert place == pytest.approx([1.5, -0.5, 1.2], abs=1e-3)
    assert scene.sim.describe_solver().endswith("for all contacts, because of cylinder and mesh")
    assert scene.sim.cfg.solver.use_mujoco_contacts is False
    assert solver.use_mujoco_contacts is None  # the config of the caller stays


def test_the_rows_name_concave_colliders_and_no_others():
    stage = new_stage()
    for path, approximation in (("/World/stairs", None), ("/World/asked", "convexHull"), ("/World/seen", "")):
        add_step(stage, path, approximation)
    rows = [row for row in load_stage(newton.ModelBuilder(), stage).ignored if row[1] == "concave mesh collider"]
    assert [row[0] for row in rows] == ["/World/stairs"]
    assert "it has hollows: its triangles collide" in rows[0][2]


@pytest.mark.filterwarnings("ignore:.*left out, converted or replaced")
def test_the_row_of_a_moving_mesh_says_what_static_scenery_decides():
    stage = new_stage()
    add_step(stage, "/World/stairs", None)
    template = UsdGeom.Xform.Define(stage, "/World/envs/env_0/stool").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(template)
    UsdGeom.XformCommonAPI(template).SetTranslate(Gf.Vec3d(0, 0, 5))
    add_step(stage, "/World/envs/env_0/stool/seat", None)
    settings = SimulationCfg(gravity=None, device="cpu")
    scene = InteractiveScene.from_usd(stage, num_envs=2, env_spacing=4.0, sim_cfg=settings)
    whys = {path: why for report in scene.builder.reports for path, what, why in report.ignored if "concave" in what}
    assert len(whys) == 2
    assert all("its triangles collide" in why for why in whys.values()), whys


def test_newton_s_bunny_is_concave():
    stage = Usd.Stage.Open(get_asset("bunny.usd"))
    bunny = newton.usd.get_mesh(next(p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)))
    depth = hollow_depth(np.array(bunny.vertices), np.array(bunny.indices).reshape(-1, 3))
    assert depth is not None
    assert depth > 0.05
