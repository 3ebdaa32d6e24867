# SPDX-License-Identifier: Apache-2.0
"""Ignored content: what Newton passes over in silence has a row in the report."""

from __future__ import annotations

import pytest

from stripe_newton.usd import StageReport, ignored_text, inspect_stage
from tests.helpers.usd_stages import usda

FLOOR = 'def Cube "floor" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {\n}\n'
SQUARE = "point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]\n"
TRIANGLES = "int[] faceVertexCounts = [3, 3]\nint[] faceVertexIndices = [0, 1, 2, 0, 2, 3]\n"
SAMPLES = "point3f[] points.timeSamples = {\n0: [(0, 0, 0), (1, 0, 0), (1, 1, 0)],\n}\n"
# Prims, and what of them has a row.
ROWS = {
    f'def BasisCurves "A" {{\nint[] curveVertexCounts = [4]\n{SQUARE}}}': "BasisCurves",
    f'def Points "A" {{\n{SQUARE}}}': "Points",
    'def Volume "A" {\n}': "Volume",
    'def Capsule_1 "A" {\ndouble radiusTop = 0.1\n}': "Capsule_1",
    'def SkelRoot "A" {\n}': "skeleton",
    f'def Mesh "A" {{\n{TRIANGLES}{SQUARE}int[] holeIndices = [1]\n}}': "holeIndices",
    f'def Mesh "A" {{\n{TRIANGLES}{SQUARE}{SAMPLES}}}': "animation",
    'def Cube "A" {\ndouble size = 1\ndouble size.timeSamples = {\n0: 1,\n1: 2,\n}\n}': "animation",
}


def rows(report: StageReport) -> list[tuple[str, str]]:
    return [(path, what) for path, what, _ in report.ignored if what != "static stage"]


@pytest.mark.parametrize(("prim", "what"), ROWS.items(), ids=[*ROWS.values()])
def test_what_is_not_read_has_a_row(prim, what):
    report = inspect_stage(usda(FLOOR + prim))
    assert rows(report) == [("/A", what)]


def test_equal_prims_share_a_row():
    curves = "".join(f'def BasisCurves "hair{k}" {{\n{SQUARE}}}\n' for k in range(5))
    assert rows(inspect_stage(usda(FLOOR + curves))) == [("/hair0 (+4 more)", "BasisCurves")]
    cameras = "".join(f'def Camera "camera{k}" {{\n}}\n' for k in range(3))
    assert rows(inspect_stage(usda(FLOOR + cameras))) == [("/camera0 (+2 more)", "camera")]


def test_a_mesh_whose_points_are_samples_alone_is_left_out_for_that():
    report = inspect_stage(usda(f'{FLOOR}def Mesh "A" {{\n{TRIANGLES}{SAMPLES}}}'))
    assert [why for path, _, why in report.ignored if path == "/A"] == [
        "is left out: it is a mesh whose points or faces have time samples alone, which are not read"
    ]


@pytest.mark.parametrize(("kind", "size"), [("Capsule", (0.3, 0.75)), ("Cylinder", (0.3, 0.75))])
@pytest.mark.parametrize("metres", [1.0, 0.01])
def test_a_capsule_of_two_equal_radii_is_a_capsule(kind, size, metres):
    sizes = f"double radiusTop = {0.3 / metres}\ndouble radiusBottom = {0.3 / metres}\ndouble height = {1.5 / metres}\n"
    prim = f'def {kind}_1 "A" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{\n{sizes}}}'
    report = inspect_stage(usda(prim, head=f'metersPerUnit = {metres}\nupAxis = "Z"'))
    (shape,) = report.shapes
    assert (shape.type, shape.collides) == (kind.lower(), True)
    assert shape.size == pytest.approx(size, rel=1e-6)
    assert ("/A", f"{kind}_1") not in rows(report)


def test_the_text_of_a_report_has_equal_rows_once():
    """The report itself has them all: a program looks for paths."""
    report = inspect_stage(usda(FLOOR))
    report.ignored = [(f"/rock{k}", "approximation", "is an estimate") for k in range(7)] + [("/tree", "a", "b")]
    text = report.to_text()
    assert text.count("is an estimate") == 1
    assert "/rock0 (+6 more)" in text
    assert "/tree" in text
    assert len(report.ignored) == 8
    warning = ignored_text("room.usda", report.ignored)
    assert warning.splitlines()[1:] == ["  /rock0 (+6 more): approximation: is an estimate", "  /tree: a: b"]
