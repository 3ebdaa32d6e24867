# SPDX-License-Identifier: Apache-2.0
"""Export of somebody else's stages: units, up axes, joints, motion and instances come back as the same model."""

from __future__ import annotations

from pathlib import Path

import newton
import numpy as np
import pytest
from pxr import Usd, UsdGeom

from stripe_newton.actuators import IdealPDActuatorCfg, ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg, UsdFileCfg
from tests.helpers.same_scene import actuator_count, assert_same
from tests.helpers.small_scenes import make_scene
from tests.helpers.usd_worlds import UNITS, instances, robots
from tools.checks.file_trial import file_scene
from tools.checks.model_arrays import different_arrays, model_arrays

PACKAGE = Path(newton.__file__).parent
# What the stages of Newton leave out is no matter here.
pytestmark = pytest.mark.filterwarnings("ignore:.*left out, converted or replaced")
WORLDS = {"robots": robots, "instances": instances}


def from_usd(stage: str | Path | Usd.Stage) -> InteractiveScene:
    return InteractiveScene.from_usd(stage, sim_cfg=SimulationCfg(gravity=None, device="cpu"))


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("world", WORLDS)
def test_a_stage_in_any_units_comes_back_as_the_same_model(tmp_path, world, units, up):
    scene = from_usd(WORLDS[world](*UNITS[units], up))
    scene.export(tmp_path / "scene.usda")
    stage = Usd.Stage.Open(str(tmp_path / "scene.usda"))
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1.0, up)
    assert_same(scene, from_usd(tmp_path / "scene.usda"))


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("units", UNITS)
def test_units_do_not_change_the_model(units, up):
    one, two = model_arrays(from_usd(robots()).sim.model), model_arrays(from_usd(robots(*UNITS[units], up)).sim.model)
    # With Y up the world is turned as a whole: what is relative to it differs.
    turned = {"body_q", "joint_q", "joint_qd", "body_qd", "joint_X_p", "shape_transform", "joint_target_q"}
    turned = turned if up == "Y" else set()
    assert float(np.abs(one["gravity"]).max()) == pytest.approx(3.7, rel=1e-6)
    for name in one:
        if name not in turned and np.issubdtype(one[name].dtype, np.floating):
            np.testing.assert_allclose(two[name], one[name], rtol=2e-5, atol=1e-6, err_msg=name)


def test_bodies_in_motion_move_the_same_way_after_a_round_trip(tmp_path):
    scene = from_usd(robots(0.01, 1.0, "Y"))
    speed = scene.sim.model.joint_qd.numpy()
    assert np.linalg.norm(speed[-6:-3]) == pytest.approx(np.linalg.norm((0.5, 0.25, 1.0)), rel=1e-5)
    scene.export(tmp_path / "scene.usda")
    again = from_usd(tmp_path / "scene.usda")
    for each in (scene, again):
        each.sim.step(20)
    np.testing.assert_array_equal(scene.sim.state.joint_q.numpy(), again.sim.state.joint_q.numpy())


def test_drive_targets_of_a_stage_are_kept():
    """They began at the initial position, as those of a robot with a config do."""
    scene = from_usd(robots())
    joint = next(j for j in scene.builder.reports[0].joints if j.path == "/World/arm/joint1")
    assert (joint.target, joint.position) == pytest.approx((0.2, 0.1))
    dof = scene.sim.template.joint_label.index("/World/arm/joint1")
    coord = scene.sim.template.joint_q_start[dof]
    assert scene.sim.model.joint_target_q.numpy()[coord] == pytest.approx(0.2)


def test_an_export_of_an_export_is_the_same(tmp_path):
    scene = from_usd(robots(0.01, 1.0, "Y"))
    scene.export(tmp_path / "one.usda")
    again = from_usd(tmp_path / "one.usda")
    again.export(tmp_path / "two.usda")
    one, two = (tmp_path / name for name in ("one.usda", "two.usda"))
    # Flattening turns lists of schemas from prepended into explicit ones.
    assert one.read_text().replace("prepend ", "") == two.read_text().replace("prepend ", "")
    assert str(tmp_path) not in two.read_text()


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("gravity", [(0.5, -1.0, -3.0), (0.0, 0.0, 0.0)])
def test_gravity_of_the_settings_is_exported_along_any_up_axis(tmp_path, gravity, up):
    cfg = SimulationCfg(gravity=gravity, device="cpu")
    InteractiveScene.from_usd(robots(0.01, 1.0, up), sim_cfg=cfg).export(tmp_path / "scene.usda")
    again = from_usd(tmp_path / "scene.usda")
    np.testing.assert_allclose(again.sim.model.gravity.numpy()[0], gravity, rtol=1e-6, atol=1e-6)


FILES = (
    "tests/assets/actuator_test.usda",
    "tests/assets/ant_mixed.usda",
    "tests/assets/humanoid_mjc.usda",
    "tests/assets/mjc_schema_import.usda",
    "tests/assets/negative_scale_mesh_pair.usda",
    "tests/assets/site_actuator_mjc.usda",
    "tests/assets/kamino/basics/boxes_fourbar.usda",
    "tests/assets/kamino/testing/joints/test_joint_cylindrical_actuated.usda",
    "tests/assets/kamino/testing/joints/test_joint_d6_6dof_actuated.usda",
    "tests/assets/kamino/testing/joints/test_joint_universal_actuated_unary.usda",
)


@pytest.mark.parametrize("file", FILES)
def test_stages_of_newton_come_back_as_the_same_model(tmp_path, file):
    scene = from_usd(PACKAGE / file)
    scene.export(tmp_path / "scene.usda")
    assert_same(scene, from_usd(tmp_path / "scene.usda"))


def test_a_joint_whose_axes_are_all_locked_is_exported(tmp_path):
    stage = robots()
    for axis in ("transY", "rotX", "rotZ"):
        joint = stage.GetPrimAtPath("/World/arm/joint4")
        joint.GetAttribute(f"limit:{axis}:physics:low").Set(1.0)
        joint.GetAttribute(f"limit:{axis}:physics:high").Set(-1.0)
    scene = from_usd(stage)
    scene.export(tmp_path / "scene.usda")
    assert_same(scene, from_usd(tmp_path / "scene.usda"))


def test_explicit_actuators_replace_those_of_the_stage(tmp_path):
    file = PACKAGE / "tests/assets/actuator_test.usda"
    ideal = IdealPDActuatorCfg(joint_names_expr=["Joint1"], stiffness=7.0, damping=1.0, effort_limit=9.0)
    soft = ImplicitActuatorCfg(joint_names_expr=["Joint2"], stiffness=3.0, damping=0.5)
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot",
        spawn=UsdFileCfg(usd_path=str(file), source_prim_path="/World/Robot"),
        actuators={"ideal": ideal, "soft": soft},
    )
    scene = make_scene({"robot": robot})
    scene.export(tmp_path / "scene.usda")
    again = InteractiveScene.from_usd(tmp_path / "scene.usda", 2, 3.0, scene.sim.cfg)
    assert different_arrays(scene.sim.model, again.sim.model) == []
    assert actuator_count(again) == actuator_count(scene)


def test_environments_that_are_left_out_have_a_row_and_names_that_are_no_paths_no_line_of_usd(tmp_path, capfd):
    scene = from_usd(PACKAGE / "tests/assets/ant_multi.usda")
    where, what, why = scene.builder.reports[0].ignored[0]
    assert (where, what, scene.num_envs) == ("/World/envs/env_1 (+62 more)", "environment", 1)
    assert "num_envs" in why
    file = tmp_path / "robot.xml"
    file.write_text("""<mujoco model="a robot"><worldbody><body name="the base"><freejoint/>
        <geom name="a box" type="box" size=".1 .1 .1"/></body></worldbody></mujoco>""")
    capfd.readouterr()
    file_scene(str(file), "mjcf").export(tmp_path / "scene.usda")
    assert "SdfPath" not in capfd.readouterr().err
