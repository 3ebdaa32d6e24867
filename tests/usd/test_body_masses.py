# SPDX-License-Identifier: Apache-2.0
"""Masses and inertias: the same rules and sentences for stages and for the files of robots."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from stripe_newton.robot_files import RobotFileError, inspect_robot_file
from stripe_newton.usd import StageError, StageReport, inspect_stage
from stripe_newton.usd.body_masses import moments_problem

USD = "warning of OpenUSD"
CASES = {
    "tiny": (1e-16, (1e-20, 1e-20, 1e-20), "has mass 1e-16 kg and a moment of inertia of 1e-20 kg m^2; MuJoCo takes"),
    "no inertia": (1.0, (0.0, 0.0, 0.0), "0 0 0 kg m^2 is of no body, as they must be positive"),
    "flat": (1.0, (1.0, 1.0, 3.0), "1 1 3 kg m^2 is of no body, as two must not add up to less than the third"),
    "sound": (1.0, (1.0, 1.0, 1.5), ""),
}


def stage_report(folder: Path, mass: float, moments: tuple[float, float, float]) -> StageReport:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z")
    prim = UsdGeom.Xform.Define(stage, "/a").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(prim)
    UsdPhysics.MassAPI.Apply(prim).CreateMassAttr(mass)
    UsdPhysics.MassAPI(prim).CreateDiagonalInertiaAttr(Gf.Vec3f(*moments))
    stage.GetRootLayer().Export(str(folder / "a.usda"))
    return inspect_stage(folder / "a.usda")


def urdf_report(folder: Path, mass: float, moments: tuple[float, float, float]) -> StageReport:
    xx, yy, zz = moments
    inertia = f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="a"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'
    joint = '<joint name="j" type="continuous"><parent link="world"/><child link="a"/></joint>'
    (folder / "a.urdf").write_text(f'<robot name="r"><link name="world"/>{link}{joint}</robot>')
    return inspect_robot_file(folder / "a.urdf")


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("report_of", [stage_report, urdf_report])
def test_stages_and_robots_are_told_the_same(report_of, name: str, tmp_path: Path) -> None:
    mass, moments, expected = CASES[name]
    if (report_of, name) == (stage_report, "no inertia"):  # OpenUSD replaces it before anybody else
        expected = "a possibly invalid inertia tensor of {1.0, 1.0, 1.0}, small sphere approximated inertia was used"
    try:
        said = [why for _, what, why in report_of(tmp_path, mass, moments).ignored if what in ("inertia", USD)]
    except (StageError, RobotFileError) as error:
        said = [str(error)]
    assert bool(said) == bool(expected)
    assert expected in "".join(said)


def test_rounding_of_a_moment_of_zero_is_no_mistake() -> None:
    assert moments_problem(np.diag([-6e-16, 3e-8, 3e-8])) == ""  # of a published hand, in single precision
    assert moments_problem(np.diag([-6e-13, 3e-8, 3e-8])).startswith("the principal moments")
