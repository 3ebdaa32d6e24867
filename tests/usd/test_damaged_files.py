# SPDX-License-Identifier: Apache-2.0
"""Damaged files and meshes: one error with the place, or a row, never a crash or a wait without end."""

from __future__ import annotations

import os
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from stripe_newton.usd import StageError, inspect_stage, open_stage
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from tests.helpers.usd_stages import body_text, load, refuse, usda

POINTS, FACES = "[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]", "[0, 1, 2, 0, 1, 3]"
SQUARE = "[(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)]"


def mesh(points=POINTS, counts="[3, 3]", indices=FACES, more="", collides=False) -> str:
    schemas = '(prepend apiSchemas = ["PhysicsCollisionAPI"])' if collides else ""
    return f"""
def Mesh "mesh" {schemas}
{{
    point3f[] points = {points}
    int[] faceVertexCounts = {counts}
    int[] faceVertexIndices = {indices}
    {more}
}}
"""


DAMAGED = [
    (mesh("[]", "[]", "[]"), "without points or faces"),
    (mesh(counts="[]", indices="[]"), "without points or faces"),
    (mesh(counts="[3, 9]"), "faceVertexCounts add up to 12, but it has 6 faceVertexIndices"),
    (mesh(counts="[-3, 9]"), "with a face of -3 points"),
    (mesh(indices="[0, 1, 2, 0, 1, 2147483647]"), "name point 2.14748e+09 of 4"),
    (mesh(indices="[0, 1, 2, 0, 1, -1]"), "name point -1 of 4"),
    (mesh(POINTS.replace("(1, 0, 0)", "(nan, 0, 0)")), "with points that are not finite"),
    (mesh(POINTS.replace("(1, 0, 0)", "(1e30, 0, 0)")), "whose point 1 is at"),
    (mesh().replace("point3f[] points = " + POINTS, 'string points = "none"'), "are not numbers"),
]


@pytest.mark.parametrize(("text", "words"), DAMAGED)
def test_a_visible_mesh_without_a_shape_is_left_out_and_drawn_around(text, words):
    scene = InteractiveScene.from_usd(usda(body_text() + text), sim_cfg=SimulationCfg(gravity=None, device="cpu"))
    row = next(row for row in scene.builder.reports[0].ignored if row[1] == "visible mesh")
    assert row[0] == "/mesh"
    assert words in row[2]
    assert SceneRenderer(scene.sim, ViewerCfg(resolution=(32, 24))).render().std() > 0.0


@pytest.mark.parametrize(("text", "words"), DAMAGED)
def test_a_mesh_collider_without_a_shape_is_refused(text, words):
    collider = text.replace('def Mesh "mesh" ', 'def Mesh "mesh" (prepend apiSchemas = ["PhysicsCollisionAPI"])')
    refuse(usda(body_text() + collider), "/mesh", words)


def test_points_that_are_no_numbers_are_left_out_in_other_units_too():
    text = mesh().replace("point3f[] points = " + POINTS, 'token points = "x"')
    _, report = load(usda(body_text() + text, 'metersPerUnit = 0.01\nupAxis = "Z"'))
    assert [why for path, what, why in report.ignored if (path, what) == ("/mesh", "visible mesh")] == [
        "is left out: it is a mesh whose points or faces are not numbers"
    ]


def test_normals_that_fit_nothing_are_left_out():
    _, report = load(usda(body_text() + mesh(more="normal3f[] normals = [(0, 0, 1)]")))
    assert ("/mesh", "normals", "left out: 1 normals for 4 (vertex)") in report.ignored
    assert "/mesh" in [s.path for s in report.shapes]


@pytest.mark.parametrize("kind", ["int normals = 7", "normal3f normals = (0, 0, 1)", "int[] normals = [0, 1, 2, 3]"])
def test_normals_of_another_type_are_left_out(kind):
    _, report = load(usda(body_text() + mesh(more=kind)))
    assert ("/mesh", "normals", f"left out: normals of type {kind.split()[0]}, must be normal3f[]") in report.ignored


def test_a_syntax_error_has_line_and_column(tmp_path):
    file = tmp_path / "scene.usda"
    file.write_text('#usda 1.0\ndef Xform "A"\n{\n    double x = = 3\n}\n')
    refuse(file, "", "line 4, column 5: Expected } at 'double x = = 3'")
    (tmp_path / "outer.usda").write_text('#usda 1.0\ndef Xform "A" (references = @scene.usda@) {\n}\n')
    refuse(tmp_path / "outer.usda", "/A", "scene.usda")


def test_bytes_that_are_not_utf8_have_line_and_column(tmp_path):
    file = tmp_path / "scene.usda"
    file.write_bytes(b'#usda 1.0\ndef Xform "A" {\n    string x = "\xff"\n}\n')
    refuse(file, "", "line 3, column 17: byte 0xff is not UTF-8")


def test_a_corrupt_crate_is_one_error(tmp_path):
    file = tmp_path / "scene.usdc"
    usda(body_text()).GetRootLayer().Export(str(file))
    whole = file.read_bytes()
    for cut in (8, 60, len(whole) // 2, len(whole) - 9):
        file.write_bytes(whole[:cut])
        with pytest.raises(StageError, match="is not a USD file that can be read"):
            open_stage(file)


def test_a_pipe_as_a_reference_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.usda")
    (tmp_path / "inner.usda").write_text('#usda 1.0\ndef "A" (references = @pipe.usda@) {\n}\n')
    file = tmp_path / "scene.usda"
    file.write_text("#usda 1.0\n(\n    subLayers = [@inner.usda@]\n)\n")
    refuse(file, "", "pipe.usda, which is no regular file")
    refuse(tmp_path / "pipe.usda", "", "is no regular file")


_CLIPS = "(clips = {dictionary default = {asset[] assetPaths = [@pipe.usda@]}})"
_PARTS = {
    "error in it": "(references = @pipe.usda@) {\nfloat x = (1, 2)\n}",
    "error below it": "(references = @broken.usda@) {\n}",
    "arguments": "(references = @pipe.usda:SDF_FORMAT_ARGS:a=b@) {\n}",
    "package": "(references = @pipe.usdz[a.usda]@) {\n}",
    "expression": '(references = @`"${NAME}.usda"`@) {\n}',
    "clips": _CLIPS + " {\n}",
    "texture": "{\nasset inputs:file = @pipe.png@\n}",
    "array": "{\nasset[] files = [@pipe.png@]\n}",
    "samples": "{\nasset inputs:file.timeSamples = {\n1: @pipe.png@,\n}\n}",
    "variant": '(variantSets = "v") {\nvariantSet "v" = {\n"a" (references = @pipe.usda@) {\n}\n}\n}',
    "payload": "(payload = @pipe.usda@) {\n}",
    "tiles": "{\nasset inputs:file = @pipe.<UDIM>.png@\n}",
}


@pytest.mark.parametrize("prim", _PARTS.values(), ids=_PARTS)
def test_a_pipe_is_found_however_a_stage_refers_to_it(tmp_path, prim):
    for suffix in ("usda", "usdz", "png", "1001.png"):
        os.mkfifo(tmp_path / f"pipe.{suffix}")
    head = '#usda 1.0\n(\nexpressionVariables = {\nstring NAME = "pipe"\n}\n)\n'
    (tmp_path / "broken.usda").write_text('#usda 1.0\ndef "A" (references = @pipe.usda@) {\nfloat x = (1, 2)\n}\n')
    file = tmp_path / "scene.usda"
    file.write_text(f'{head}def "A" {prim}\n')
    refuse(file, "", "which is no regular file")


_TEXTURED = """#usda 1.0
def Material "M" {
    token outputs:surface.connect = </M/S.outputs:surface>
    def Shader "S" {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>
        token outputs:surface
    }
    def Shader "T" {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @FILE@
        float3 outputs:rgb
    }
}
def Mesh "A" (prepend apiSchemas = ["MaterialBindingAPI", "PhysicsCollisionAPI"]) {
    rel material:binding = </M>
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
}
"""


def test_textures_that_cannot_be_read_are_rows_and_the_mesh_is_drawn(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    for name in ("good.png", "cut.png", "cut.jpg", "t.1001.png"):
        Image.fromarray(noise).save(tmp_path / name)
    for name in ("cut.png", "cut.jpg"):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:900])
    (tmp_path / "text.png").write_text("hello")
    reasons = {"good.png": "", "cut.png": "cannot be read", "cut.jpg": "cannot be read", "text.png": "is no picture",
               "gone.png": "does not exist", "https://example.org/a.png": "is on the web",
               "t.<UDIM>.png": "has several tiles", ".": "is no file"}  # fmt: skip
    for number, (name, reason) in enumerate(reasons.items()):
        (file := tmp_path / f"scene_{number}.usda").write_text(_TEXTURED.replace("FILE", name))
        cfg = SimulationCfg(device="cpu")
        with warnings.catch_warnings(action="ignore"):
            scene = InteractiveScene.from_usd(file, sim_cfg=cfg)
        rows = [why for path, what, why in scene.builder.reports[0].ignored if (path, what) == ("/A", "texture")]
        assert len(rows) == bool(reason), name
        assert reason in "".join(rows), name
        SceneRenderer(scene.sim, ViewerCfg(resolution=(16, 16))).render()
        scene.close()


@pytest.mark.parametrize("name", ["damaged.png", "damaged.bmp"])
def test_a_texture_that_is_damaged_inside_is_told_when_it_is_drawn(tmp_path, name):
    """Not at import, which may open thousands; but formats whose end says nothing are read there."""
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / name)
    data = bytearray((tmp_path / name).read_bytes())
    data[2000:2100] = bytes(100)
    (tmp_path / name).write_bytes(data if name.endswith("png") else data[:4000])
    (file := tmp_path / "scene.usda").write_text(_TEXTURED.replace("FILE", name))
    with warnings.catch_warnings(action="ignore"):
        scene = InteractiveScene.from_usd(file, sim_cfg=SimulationCfg(device="cpu"))
    rows = [row for row in scene.builder.reports[0].ignored if row[1] == "texture"]
    assert len(rows) == name.endswith("bmp")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        SceneRenderer(scene.sim, ViewerCfg(resolution=(16, 16))).render()
    told = [str(warning.message) for warning in caught if "texture" in str(warning.message)]
    assert len(told) == name.endswith("png")
    assert all(text.startswith("/A: texture: left out") and "cannot be read" in text for text in told)
    scene.close()


def test_two_disabled_bodies_with_a_joint_between_them_are_static():
    off = "bool physics:rigidBodyEnabled = false"
    joint = 'def PhysicsRevoluteJoint "j" {\nrel physics:body0 = </A>\nrel physics:body1 = </B>\n}\n'
    report = inspect_stage(usda(body_text(off) + body_text(off, name="B") + joint))
    assert not report.bodies
    assert ("/j", "joint", "left out: it joins static geometry alone") in report.ignored


def test_a_body_below_the_prim_of_another_body():
    inner = 'def Xform "I" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])\n{\n' + body_text(name="B") + "\n}\n"
    text = body_text(inner.replace('"PhysicsRigidBodyAPI"', '"X"', 1))
    scene = InteractiveScene.from_usd(usda(text), sim_cfg=SimulationCfg(gravity=None, device="cpu"))
    assert sorted(scene.rigid_objects) == ["A", "B"]


# ---------------------------------------------------------------- flat meshes and stages in which nothing moves


def floor(points=SQUARE, indices="[0, 1, 2, 3]") -> str:
    return mesh(points, "[4]", indices, collides=True)


@pytest.mark.parametrize("indices", ["[0, 1, 2, 3]", "[3, 2, 1, 0]"])
def test_a_flat_mesh_as_the_ground_carries_a_box(indices):
    place = 'double3 xformOp:translate = (0.3, 0.2, 0.1)\nuniform token[] xformOpOrder = ["xformOp:translate"]'
    stage = usda(body_text(place, "double size = 0.2") + floor(indices=indices))
    scene = InteractiveScene.from_usd(stage, sim_cfg=SimulationCfg(device="cpu", dt=0.005))
    row = next(row for row in scene.builder.reports[0].ignored if row[1] == "flat mesh collider")
    assert row[0] == "/mesh"
    scene.sim.step(100)
    height = float(scene.sim.state.joint_q.numpy()[2])
    front = 0.0 if indices == "[0, 1, 2, 3]" else 0.02  # turned over, its front side looks down
    assert height == pytest.approx(0.1 + front, abs=5e-3)


def test_the_plate_of_a_flat_mesh_is_closed_and_behind_its_front():
    builder, _ = load(usda(body_text() + floor()))
    plate = builder.shape_source[builder.shape_label.index("/mesh")]
    points, faces = np.array(plate.vertices, dtype=float), np.array(plate.indices).reshape(-1, 3)
    assert points[:, 2].min() == pytest.approx(-0.02)
    assert points[:, 2].max() == pytest.approx(0.0)
    a, b, c = (points[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0 == pytest.approx(100.0 * 0.02, rel=1e-5)


def test_the_plate_of_squares_that_repeat_their_points_has_no_walls_inside():
    points = "[(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (1, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0)]"
    builder, _ = load(usda(body_text() + mesh(points, "[4, 4]", "[0, 1, 2, 3, 4, 5, 6, 7]", collides=True)))
    plate = builder.shape_source[builder.shape_label.index("/mesh")]
    assert len(plate.indices) // 3 == 2 * 4 + 2 * 6  # both sides, and six edges around
    whole = trimesh.Trimesh(plate.vertices, np.array(plate.indices).reshape(-1, 3))
    assert whole.is_watertight
    assert whole.volume == pytest.approx(2.0 * 0.02, rel=1e-5)


def test_flat_meshes_that_cannot_be_a_plate_are_refused():
    line = "[(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)]"
    refuse(usda(body_text() + floor(line)), "/mesh", "points are all on one line")
    refuse(usda(body_text(floor())), "/A/mesh", "is a flat mesh collider on a rigid body")


@pytest.mark.parametrize(
    "text",
    [
        'def Cube "cube" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {\n}\n',
        'def Cube "cube" {\n}\n',
        mesh(),
        body_text("bool physics:rigidBodyEnabled = false"),
    ],
)
@pytest.mark.parametrize("num_envs", [1, 3])
def test_a_stage_in_which_nothing_moves_loads_is_drawn_and_comes_back(tmp_path, text, num_envs):
    cfg = SimulationCfg(gravity=None, device="cpu")
    scene = InteractiveScene.from_usd(usda(text), num_envs, 4.0, sim_cfg=cfg)
    assert "static stage" in [row[1] for row in scene.builder.reports[0].ignored]
    assert scene.sim.describe_solver() == "nothing moves"
    scene.sim.step(3)
    scene.reset()
    assert scene.keys() == []
    assert SceneRenderer(scene.sim, ViewerCfg(resolution=(32, 24))).render().std() > 0.0
    scene.export(tmp_path / "scene.usda")
    again = InteractiveScene.from_usd(tmp_path / "scene.usda", num_envs, 4.0, sim_cfg=cfg)
    np.testing.assert_array_equal(again.sim.model.shape_transform.numpy(), scene.sim.model.shape_transform.numpy())


def test_a_stage_without_any_shape_is_refused():
    with pytest.raises(StageError, match="nothing in it has a shape"):
        InteractiveScene.from_usd(usda('def Camera "c" {\n}\n'))
    with pytest.raises(StageError, match="nothing in it has a shape"):
        inspect_stage(usda(""))
