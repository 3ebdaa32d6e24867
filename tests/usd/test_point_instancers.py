# SPDX-License-Identifier: Apache-2.0
"""Point instancers: instances are read with the physics of their prototypes, or the stage is refused."""

from __future__ import annotations

import newton
import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from stripe_newton.usd import StageError, load_stage
from tests.helpers.usd_stages import add_body, new_stage


def rocks(kinds: list[int], at: list[tuple[float, float, float]], metres: float = 1.0, up: str = "Z") -> Usd.Stage:
    """An instancer at (0, 1, 0) with two prototypes, a body and a static box 0.5 above their origin."""
    stage = new_stage(metres, up=up)
    unit = 1.0 / metres
    instancer = UsdGeom.PointInstancer.Define(stage, "/World/rocks")
    UsdGeom.XformCommonAPI(instancer).SetTranslate(Gf.Vec3d(0, 1, 0) * unit)
    add_body(stage, "/World/rocks/P/ball", (0, 0, 0.5 * unit))
    UsdGeom.Cube(stage.GetPrimAtPath("/World/rocks/P/ball/box")).CreateSizeAttr(0.2 * unit)
    box = UsdGeom.Cube.Define(stage, "/World/rocks/P/box")
    box.CreateSizeAttr(0.2 * unit)
    UsdPhysics.CollisionAPI.Apply(box.GetPrim())
    instancer.CreatePrototypesRel().SetTargets(["/World/rocks/P/ball", "/World/rocks/P/box"])
    instancer.CreateProtoIndicesAttr(kinds)
    instancer.CreatePositionsAttr([Gf.Vec3f(*p) * unit for p in at])
    return stage


@pytest.mark.parametrize("metres", [1.0, 0.01])
def test_instances_are_read_where_they_are_with_their_physics(metres):
    stage = rocks([0, 1, 0], [(0, 0, 1), (1, 0, 1), (2, 0, 1)], metres)
    UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/rocks")).CreateInvisibleIdsAttr([2])
    builder = newton.ModelBuilder()
    report = load_stage(builder, stage)
    assert builder.body_label == ["/World/rocks_instances/instance_0"]
    np.testing.assert_allclose(builder.body_q[0][:3], (0.0, 1.0, 1.5), atol=1e-6)
    assert builder.shape_body == [0, -1]
    np.testing.assert_allclose(builder.shape_transform[1][:3], (1.0, 1.0, 1.0), atol=1e-6)
    (row,) = [row for row in report.ignored if row[1] == "point instancer"]
    assert row[0] == "/World/rocks"
    assert "each of its 2 instances" in row[2]
    assert stage.GetPrimAtPath("/World/rocks").IsActive(), "the given stage was changed"


@pytest.mark.filterwarnings("ignore:.*left out, converted or replaced")
def test_a_scene_of_instances_comes_back(tmp_path):
    scenes = [InteractiveScene.from_usd(rocks([0, 0], [(0, 0, 1), (1, 0, 1)]), sim_cfg=SimulationCfg(device="cpu"))]
    scenes[0].export(tmp_path / "rocks.usda")
    scenes.append(InteractiveScene.from_usd(tmp_path / "rocks.usda", sim_cfg=SimulationCfg(device="cpu")))
    one, two = (scene.sim.state.body_q.numpy() for scene in scenes)
    assert len(one) == 2
    np.testing.assert_array_equal(one, two)


MANY = 20001


def too_many(instancer: UsdGeom.PointInstancer) -> None:
    instancer.CreateProtoIndicesAttr([0] * MANY)
    instancer.CreatePositionsAttr([Gf.Vec3f(0)] * MANY)


def name_prototypes(*paths: str):
    return lambda instancer: instancer.GetPrototypesRel().SetTargets(list(paths))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda i: i.CreateProtoIndicesAttr([0, 7]), r"/World/rocks: its protoIndices have 7, but there are 2"),
        (lambda i: i.CreatePositionsAttr([Gf.Vec3f(0)]), r"its positions are 1, its protoIndices 2; author as many"),
        (name_prototypes("/World/gone", "/World/rocks/P/box"), r"its prototype /World/gone does not exist"),
        (name_prototypes("/World", "/World/rocks/P/box"), r"its prototype /World holds the instancer itself"),
        (too_many, r"has 20001 instances; a stage may have 20000 in all"),
        (
            lambda i: UsdGeom.PointInstancer.Define(i.GetPrim().GetStage(), "/World/rocks/P/more"),
            r"has another point instancer as a part, /World/rocks/P/more",
        ),
    ],
)
def test_an_instancer_that_cannot_be_read_is_refused(change, message):
    stage = rocks([0, 1], [(0, 0, 1), (1, 0, 1)])
    change(UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/rocks")))
    with pytest.raises(StageError, match=message):
        load_stage(newton.ModelBuilder(), stage)
