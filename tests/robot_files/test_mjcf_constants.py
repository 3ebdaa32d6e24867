# SPDX-License-Identifier: Apache-2.0
"""Constants that Newton's conversion computes otherwise than MuJoCo's compiler: each difference has a row."""

from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest
from newton.solvers import SolverMuJoCo

from stripe_newton.robot_files import import_robot_file
from stripe_newton.usd import StageReport

BALL = '<geom size="0.1"/>'
SLIDES = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
MARKER = '<geom name="marker" pos="0 0 0.1" size="0.01" mass="0"/>'
CASES = {
    "slides": (f'<body name="bead">{SLIDES}{BALL}</body>', "inverse weight", "it only slides"),
    "no mass": (
        f'<body name="arm"><joint axis="0 1 0"/><geom pos="0.2 0 0" size="0.1"/><body name="tip" pos="0.3 0 0">{MARKER}'
        "</body></body>",
        "inverse weight",
        "it has no mass",
    ),
    "ref": (
        '<body name="arm"><joint name="hip" axis="0 1 0"/><geom pos="0.2 0 0" size="0.1"/>'
        '<body name="leg" pos="0.4 0 0">'
        '<joint name="knee" axis="0 1 0" ref="40"/><geom pos="0 0 0.3" size="0.1"/></body></body>',
        "inverse weights",
        "at its ref",
    ),
    "none": (f'<body name="ball"><freejoint/>{BALL}</body>', "", ""),
}  # fmt: skip


def import_file(path: Path, **options: object) -> tuple[newton.ModelBuilder, StageReport]:
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    return builder, import_robot_file(builder, "mjcf", path, {"ignore_names": (), **options})


@pytest.mark.parametrize("case", CASES)
def test_inverse_weights_that_differ_have_a_row(case: str, tmp_path: Path) -> None:
    bodies, what, why = CASES[case]
    path = tmp_path / "robot.xml"
    path.write_text(f'<mujoco><compiler angle="degree"/><worldbody>{bodies}</worldbody></mujoco>')
    builder, report = import_file(path)
    ours = SolverMuJoCo(builder.finalize(device="cpu"), use_mujoco_cpu=True).mj_model
    theirs = mujoco.MjModel.from_xml_path(str(path))
    differ = not np.allclose(ours.body_invweight0, theirs.body_invweight0, rtol=1e-3)
    rows = [row for row in report.ignored if row[1].startswith("inverse weight")]
    assert differ == bool(what)
    assert [row[1] for row in rows] == ([what] if what else [])
    assert all(why in row[2] for row in rows)


def test_a_hull_with_fewer_corners_has_a_row(tmp_path: Path) -> None:
    sphere = newton.Mesh.create_sphere(0.1, num_latitudes=20, num_longitudes=20)
    points, faces = np.array(sphere.vertices), np.array(sphere.indices).reshape(-1, 3) + 1
    lines = [*("v {} {} {}".format(*p) for p in points), *("f {} {} {}".format(*f) for f in faces)]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    path = tmp_path / "robot.xml"
    asset = '<asset><mesh name="ball" file="ball.obj"/></asset>'
    body = '<body name="b"><freejoint/><geom type="mesh" mesh="ball"/></body>'
    path.write_text(f"<mujoco>{asset}<worldbody>{body}</worldbody></mujoco>")
    _, report = import_file(path)
    (row,) = [row for row in report.ignored if row[1] == "convex hull"]
    assert "corners in MuJoCo, 64 here" in row[2]
    builder, report = import_file(path, mesh_maxhullvert=-1)
    assert not [row for row in report.ignored if row[1] == "convex hull"]
    ours = SolverMuJoCo(builder.finalize(device="cpu"), use_mujoco_cpu=True).mj_model
    theirs = mujoco.MjModel.from_xml_path(str(path))
    assert ours.mesh_graph[ours.mesh_graphadr[0]] == theirs.mesh_graph[theirs.mesh_graphadr[0]]


WEDGE = "0 0 0  0.3 0 0  0 0.1 0  0 0 0.1"
CUBE = "0 0 0  1 0 0  0 1 0  1 1 0  0 0 1  1 0 1  0 1 1  1 1 1"


@pytest.mark.parametrize(("vertices", "bodies"), [(WEDGE, 2), (WEDGE, 1), (CUBE, 2)])
def test_meshes_about_another_point_have_a_row(vertices: str, bodies: int, tmp_path: Path) -> None:
    """Where two of them can be deep in each other: the search for their contacts starts at these points."""
    path = tmp_path / "robot.xml"
    parts = [f'<body pos="0 0 {k}"><freejoint/><geom type="mesh" mesh="part"/></body>' for k in range(bodies)]
    asset = f'<asset><mesh name="part" vertex="{vertices}"/></asset>'
    path.write_text(f"<mujoco>{asset}<worldbody>{''.join(parts)}</worldbody></mujoco>")
    builder, report = import_file(path)
    ours = SolverMuJoCo(builder.finalize(device="cpu"), use_mujoco_cpu=True).mj_model
    apart = not np.allclose(ours.geom_pos, mujoco.MjModel.from_xml_path(str(path)).geom_pos, atol=1e-4)
    assert apart == (vertices == WEDGE)
    rows = [row[0] for row in report.ignored if row[1] == "centre of the mesh"]
    assert rows == (["part"] if apart and bodies > 1 else [])
