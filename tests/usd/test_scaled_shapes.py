# SPDX-License-Identifier: Apache-2.0
"""Scaled shapes: what a chain of transforms makes of a shape, against OpenUSD's matrices in double precision."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import newton
import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from stripe_newton.terrains.collider_mesh import triangles_of
from stripe_newton.usd import StageReport, load_stage
from tests.helpers.usd_stages import add_joint, new_stage

Points = NDArray[np.float64]
RADIUS, HALF = 0.3, 0.5
AXES = {"X": [1, 2, 0], "Y": [2, 0, 1], "Z": [0, 1, 2]}
"""For each axis of a shape, its coordinates across, across and along."""


def distance_to_sphere(points: Points) -> Points:
    return np.linalg.norm(points, axis=1) - RADIUS


def distance_to_cube(points: Points) -> Points:
    return np.abs(points).max(axis=1) - RADIUS


def distance_to_capsule(points: Points) -> Points:
    along = np.clip(points[:, 2], -HALF, HALF)
    return np.linalg.norm(points - np.c_[np.zeros((len(points), 2)), along], axis=1) - RADIUS


def distance_to_cylinder(points: Points) -> Points:
    return np.maximum(np.hypot(points[:, 0], points[:, 1]) - RADIUS, np.abs(points[:, 2]) - HALF)


def distance_to_cone(points: Points) -> Points:
    around = np.hypot(points[:, 0], points[:, 1]) - RADIUS * (HALF - points[:, 2]) / (2.0 * HALF)
    return np.maximum(around, -HALF - points[:, 2])


SHAPES: dict[str, tuple[Callable[[Points], Points], float]] = {
    "Sphere": (distance_to_sphere, 4.0 / 3.0 * np.pi * RADIUS**3),
    "Cube": (distance_to_cube, (2.0 * RADIUS) ** 3),
    "Capsule": (distance_to_capsule, np.pi * RADIUS**2 * 2 * HALF + 4.0 / 3.0 * np.pi * RADIUS**3),
    "Cylinder": (distance_to_cylinder, np.pi * RADIUS**2 * 2 * HALF),
    "Cone": (distance_to_cone, np.pi * RADIUS**2 * 2 * HALF / 3.0),
}
"""Distance function (near the surface), and volume [m^3]."""
CHAINS = {
    "scale": [((0.0, 0.0, 1.0), (0, 0, 0), (2.0, 1.0, 0.5))],
    "scale and rotation": [((0.3, 0.2, 1.0), (20, 30, 40), (0.6, 1.3, 0.9)), ((0.1, 0.0, 0.2), (0, 90, 0), (1, 1, 1))],
    "shear": [((0.3, 0.2, 1.0), (20, 30, 40), (2.0, 1.0, 0.5)), ((0.1, 0.2, 0.3), (10, 50, 45), (1.0, 0.7, 1.2))],
    "mirror and shear": [((0, 0, 1.0), (5, 0, 0), (-2.0, 1.0, 0.5)), ((0.1, 0.2, 0.3), (0, 0, 45), (1, 1, 1))],
}
"""Transforms from the world to a shape: translation [m], angles [degree], scale."""


def add_shape(stage: Usd.Stage, path: str, kind: str, axis: str) -> Usd.Prim:
    shape = getattr(UsdGeom, kind).Define(stage, path)
    if kind == "Cube":
        shape.CreateSizeAttr(2.0 * RADIUS)
    else:
        shape.CreateRadiusAttr(RADIUS)
    if kind not in ("Cube", "Sphere"):
        shape.CreateHeightAttr(2.0 * HALF)
        shape.CreateAxisAttr(axis)
    UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
    return shape.GetPrim()


def add_chain(stage: Usd.Stage, path: str, chain: list) -> str:
    for k, (translation, angles, scale) in enumerate(chain):
        path += f"/level_{k}"
        common = UsdGeom.XformCommonAPI(UsdGeom.Xform.Define(stage, path))
        common.SetTranslate(Gf.Vec3d(*translation))
        common.SetRotate(Gf.Vec3f(*angles))
        common.SetScale(Gf.Vec3f(*scale))
    return path


def whats(report: StageReport, path: str) -> list[str]:
    return [what for where, what, _ in report.ignored if where == path]


def check(builder: newton.ModelBuilder, stage: Usd.Stage, path: str, kind: str, axis: str) -> None:
    """The surface of a shape is that of the stage, within the facets' 1 mm; so is its body's mass."""
    shape = builder.shape_label.index(path)
    points, faces = triangles_of(builder, [shape], np.array(builder.body_q, dtype=float).reshape(-1, 7))
    matrix = np.array(UsdGeom.Xformable(stage.GetPrimAtPath(path)).ComputeLocalToWorldTransform(0))
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.einsum("fi,fi->", corners[:, 0], normals) / 6.0
    distance, exact = SHAPES[kind]
    exact *= abs(np.linalg.det(matrix[:3, :3]))
    assert volume == pytest.approx(exact, rel=1e-2)  # positive: its front side is outside
    samples = np.concatenate([points, corners.mean(axis=1)])
    local = (np.c_[samples, np.ones(len(samples))] @ np.linalg.inv(matrix))[:, :3]
    assert np.abs(distance(local[:, AXES[axis]])).max() < 2.5e-3
    body = builder.shape_body[shape]
    if body >= 0:
        assert builder.body_mass[body] == pytest.approx(exact * 1000.0, rel=1e-2)


@pytest.mark.parametrize("chain", CHAINS)
def test_a_shape_is_what_the_stage_shows(chain: str) -> None:
    stage, shapes = new_stage(), []
    for kind in SHAPES:
        for axis in ("Z",) if kind in ("Sphere", "Cube") else AXES:
            # Bodies under a mirroring scale are refused.
            for moves in (False,) if chain.startswith("mirror") else (False, True):
                top = f"/World/{kind}_{axis}_{int(moves)}"
                UsdGeom.Xform.Define(stage, top)
                shapes.append((f"{add_chain(stage, top, CHAINS[chain])}/shape", kind, axis))
                add_shape(stage, *shapes[-1])
                if moves:
                    UsdPhysics.RigidBodyAPI.Apply(stage.GetPrimAtPath(f"{top}/level_0"))
    builder = newton.ModelBuilder()
    report = load_stage(builder, stage)
    for path, kind, axis in shapes:
        check(builder, stage, path, kind, axis)
        if chain.endswith("shear"):
            assert whats(report, path) == ["shear"]


def test_shapes_that_stay_of_their_kind_have_no_row() -> None:
    stage = new_stage()
    for kind, scale in (("Sphere", (2, -2, 2)), ("Cube", (2, 1, 0.5)), ("Cylinder", (2, 2, 0.5)), ("Cone", (1, 1, 3))):
        parent = add_chain(stage, f"/World/{kind}", [((0, 0, 1), (10, 20, 30), scale)])
        add_shape(stage, f"{parent}/shape", kind, "Z")
    builder = newton.ModelBuilder()
    report = load_stage(builder, stage)
    for kind, name in (("Sphere", "SPHERE"), ("Cube", "BOX"), ("Cylinder", "CYLINDER"), ("Cone", "CONE")):
        path = f"/World/{kind}/level_0/shape"
        assert builder.shape_type[builder.shape_label.index(path)] == newton.GeoType[name]
        assert not whats(report, path)
        check(builder, stage, path, kind, "Z")


def test_an_egg_keeps_its_centre_of_mass_and_is_exported(tmp_path: Path) -> None:
    stage = new_stage()
    egg = add_shape(stage, "/World/egg", "Sphere", "Z")
    UsdGeom.XformCommonAPI(egg).SetScale(Gf.Vec3f(2, 1, 1))
    UsdPhysics.RigidBodyAPI.Apply(egg)
    UsdPhysics.MassAPI.Apply(egg).CreateCenterOfMassAttr(Gf.Vec3f(0.1, 0, 0))
    cfg = SimulationCfg(gravity=None, device="cpu", dt=1 / 200)
    with pytest.warns(UserWarning, match="scale 2 x 1 x 1: is not one of a Sphere"):
        scene = InteractiveScene.from_usd(stage, sim_cfg=cfg)
    assert scene.sim.template.body_com[0][0] == pytest.approx(0.2)
    scene.export(tmp_path / "egg.usda")
    with pytest.warns(UserWarning, match="scale 2 x 1 x 1"):
        again = InteractiveScene.from_usd(tmp_path / "egg.usda", sim_cfg=cfg)
    for name in ("body_mass", "body_com", "body_inertia"):
        assert (getattr(again.sim.model, name).numpy() == getattr(scene.sim.model, name).numpy()).all()


def test_what_cannot_be_baked_is_told() -> None:
    stage = new_stage()
    for name in ("jointed", "parent", "prototype"):
        prim = add_shape(stage, f"/World/{name}", "Sphere", "Z")
        UsdGeom.XformCommonAPI(prim).SetScale(Gf.Vec3f(2, 1, 1))
    UsdPhysics.RigidBodyAPI.Apply(stage.GetPrimAtPath("/World/jointed"))
    add_joint(stage, "/World/joint", None, "/World/jointed")
    add_shape(stage, "/World/parent/child", "Cube", "Z")
    copy = stage.DefinePrim("/World/copy")
    copy.GetReferences().AddInternalReference("/World/prototype")
    UsdGeom.XformCommonAPI(copy).SetScale(Gf.Vec3f(1, 1, 1))
    ignored = load_stage(newton.ModelBuilder(), stage).ignored
    rows = {path: why for path, what, why in ignored if what.startswith("scale")}
    assert set(rows) == {"/World/jointed", "/World/parent", "/World/prototype"}
    assert "a joint holds it" in rows["/World/jointed"]
    assert "shapes below it" in rows["/World/parent"]
    assert "other prims refer to it" in rows["/World/prototype"]
