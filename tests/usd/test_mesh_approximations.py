# SPDX-License-Identifier: Apache-2.0
"""Approximations of meshes: spheres at rest in a room, on a table and on stairs, whatever is authored."""

import importlib.util
import time
from collections.abc import Sequence
from pathlib import Path

import newton
import numpy as np
import pytest
import trimesh
from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from stripe_newton.usd import load_stage, mesh_approximations
from tests.helpers.usd_stages import add_body, new_stage

RADIUS = 0.08
Box = tuple[Sequence[float], Sequence[float]]
LEGS = [((x, y, 0.0), (x + 0.06, y + 0.06, 0.7)) for x in (-0.95, 0.89) for y in (-0.45, 0.39)]
MESHES: dict[str, list[Box]] = {
    "room": [((-3, -3, -0.2), (3, 3, 0)), ((-3.2, -3, 0), (-3, 3, 2.5)), ((3, -3, 0), (3.2, 3, 2.5)),
             ((-3, -3.2, 0), (3, -3, 2.5)), ((-3, 3, 0), (3, 3.2, 2.5))],
    "table": [((-1, -0.5, 0.7), (1, 0.5, 0.75)), *LEGS],
    "stairs": [((0.3 * i, -0.5, 0), (0.3 * (i + 1), 0.5, 0.15 * (i + 1))) for i in range(5)],
}  # fmt: skip
"""Boxes of each mesh, from corner to corner; they share faces, as those of a modelling program often do."""
PLACES = {
    "room": [(x, y, 0.0) for x, y in ((0, 0), (-2.5, -2.5), (2.5, 2.5), (-2.5, 2.5), (1, -2))],
    "table": [(x, y, 0.75) for x, y in ((0, 0), (-0.9, -0.4), (0.9, 0.4), (-0.9, 0.4), (0.5, -0.3))],
    "stairs": [(0.3 * i + 0.15, 0.3 * (-1) ** i, 0.15 * (i + 1)) for i in range(5)],
}
"""What is below each sphere."""


def add_mesh(stage: Usd.Stage, path: str, boxes: Sequence[Box], approximation: str | None) -> None:
    """Add boxes as the collider of one mesh."""
    lows, highs = (np.array(corners, dtype=float) for corners in zip(*boxes, strict=True))
    parts = [trimesh.creation.box(high - low) for low, high in zip(lows, highs, strict=True)]
    points = np.concatenate([p.vertices + (a + b) / 2 for p, a, b in zip(parts, lows, highs, strict=True)])
    faces = np.concatenate([part.faces + 8 * k for k, part in enumerate(parts)])
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.reshape(-1).tolist())
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    if approximation:
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(approximation)


@pytest.mark.filterwarnings("ignore:.*left out, converted or replaced")
@pytest.mark.parametrize("approximation", [None, "none", "sdf", "meshSimplification", "convexDecomposition"])
def test_spheres_rest_on_what_the_mesh_shows(approximation: str | None) -> None:
    for name, places in PLACES.items():
        stage = new_stage()
        add_mesh(stage, f"/World/{name}", MESHES[name], approximation)
        for k, (x, y, z) in enumerate(places):
            prim = add_body(stage, f"/World/ball_{k}", (x, y, z + RADIUS + 0.1), collider=False)
            sphere = UsdGeom.Sphere.Define(stage, f"/World/ball_{k}/sphere")
            sphere.CreateRadiusAttr(RADIUS)
            UsdPhysics.CollisionAPI.Apply(sphere.GetPrim())
            assert prim
        scene = InteractiveScene.from_usd(stage, sim_cfg=SimulationCfg(gravity=None, device="cpu", dt=1 / 200))
        scene.sim.step(200)
        found = scene.sim.state.joint_q.numpy().reshape(-1, 7)[:, :3]
        assert found == pytest.approx(np.array(places) + [0, 0, RADIUS], abs=1e-3), name
        whats = [what for path, what, _ in scene.builder.reports[0].ignored if path == f"/World/{name}"]
        assert "concave mesh collider" in whats
        replaced = approximation in ("meshSimplification", "convexDecomposition")
        assert (f"approximation {approximation}" in whats) == replaced


def stage_with_a_table_that_moves(approximation: str) -> Usd.Stage:
    stage = new_stage()
    table = add_body(stage, "/World/table", (0, 0, 1), collider=False)
    add_mesh(stage, "/World/table/mesh", MESHES["table"], approximation)
    UsdGeom.XformCommonAPI(table).SetTranslate(Gf.Vec3d(0, 0, 1))
    return stage


def test_a_mesh_that_moves_is_decomposed() -> None:
    pytest.importorskip("coacd")
    builder = newton.ModelBuilder()
    report = load_stage(builder, stage_with_a_table_that_moves("convexDecomposition"))
    assert sum(bool(shape.collides) for shape in report.shapes) == 5  # the top and four legs
    assert not [row for row in report.ignored if row[1].startswith(("approximation", "concave"))]


def test_convex_parts_are_kept_and_told_where_they_take_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    coacd = pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    split, calls = coacd.run_coacd, []

    def slow(*args: object, **options: object) -> object:
        calls.append(args)
        time.sleep(0.3)
        return split(*args, **options)

    monkeypatch.setattr(coacd, "run_coacd", slow)
    monkeypatch.setattr(mesh_approximations, "_LONG", 0.1)
    for again in (False, True):
        report = load_stage(newton.ModelBuilder(), stage_with_a_table_that_moves("convexDecomposition"))
        assert sum(bool(shape.collides) for shape in report.shapes) == 5
        told = capfd.readouterr().err
        assert again or f"the parts are kept in {tmp_path}/stripe-newton/convex for the next time" in told
    assert len(calls) == 5  # of the first time: the table is made of five boxes
    assert newton.config.cache_dir_meshes is None


def test_without_coacd_its_hull_collides_and_a_row_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "coacd" else find(name))
    report = load_stage(newton.ModelBuilder(), stage_with_a_table_that_moves("convexDecomposition"))
    rows = {what: why for _, what, why in report.ignored}
    assert "pip install 'stripe-newton[decomposition]'" in rows["approximation convexDecomposition"]
    assert "its convex hull collides" in rows["concave mesh collider"]


@pytest.mark.filterwarnings("ignore:.*left out, converted or replaced")
@pytest.mark.parametrize(("approximation", "inside"), [("sdf", True), ("none", False)])
def test_a_ball_lies_in_a_bowl_that_moves_if_its_distances_collide(approximation: str, inside: bool) -> None:
    stage = new_stage()
    add_mesh(stage, "/World/floor", [((-2, -2, -0.1), (2, 2, 0))], None)
    UsdPhysics.MassAPI.Apply(add_body(stage, "/World/bowl", (0, 0, 0.01), collider=False)).CreateMassAttr(2.0)
    bottom = ((-0.3, -0.3, 0), (0.3, 0.3, 0.05))
    sides = [((s - 0.05, -0.3, 0.05), (s, 0.3, 0.3)) for s in (-0.25, 0.3)]
    ends = [((-0.25, s - 0.05, 0.05), (0.25, s, 0.3)) for s in (-0.25, 0.3)]
    add_mesh(stage, "/World/bowl/mesh", [bottom, *sides, *ends], approximation)
    add_body(stage, "/World/ball", (0.02, 0.01, 0.4), collider=False)
    UsdGeom.Sphere.Define(stage, "/World/ball/sphere").CreateRadiusAttr(RADIUS)
    UsdPhysics.CollisionAPI.Apply(stage.GetPrimAtPath("/World/ball/sphere"))
    scene = InteractiveScene.from_usd(stage, sim_cfg=SimulationCfg(gravity=None, device="cpu", dt=1 / 240))
    scene.sim.step(150)
    bowl, ball = scene.sim.state.body_q.numpy()[:, :3]
    assert (scene.sim.pipeline is not None) == inside
    why = next(why for path, what, why in scene.builder.reports[0].ignored if path == "/World/bowl/mesh")
    assert ("its triangles collide" in why) == inside
    if inside:
        assert "Newton's collision detection finds all contacts of the scene" in why
        assert "the concave mesh '/World/bowl/mesh' that moves as 'sdf'" in scene.sim.describe_solver()
        np.testing.assert_allclose(bowl[2], 0.0, atol=1e-3)
        np.testing.assert_allclose(ball[2], 0.05 + RADIUS, atol=1e-3)
    else:
        assert ball[2] > 0.3  # on the lid that the hull has


def test_a_body_keeps_the_approximation_of_a_static_mesh_it_refers_to() -> None:
    pytest.importorskip("coacd")
    stage = new_stage()
    add_mesh(stage, "/World/prototype", MESHES["table"], "convexDecomposition")
    add_body(stage, "/World/table", (0, 0, 3), collider=False)
    stage.DefinePrim("/World/table/mesh").GetReferences().AddInternalReference("/World/prototype")
    report = load_stage(newton.ModelBuilder(), stage)
    shapes = [shape.path for shape in report.shapes if shape.collides]
    assert sum(path.startswith("/World/table/mesh") for path in shapes) == 5  # the top and four legs
    assert sum(path.startswith("/World/prototype") for path in shapes) == 1  # triangles
