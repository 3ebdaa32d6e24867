# SPDX-License-Identifier: Apache-2.0
"""Options of URDF files: merged bodies, gains of drives, capsules in place of cylinders."""

from __future__ import annotations

from pathlib import Path

import newton
import pytest

from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import UrdfFileCfg
from tests.helpers.small_scenes import make_scene

BODY = (
    '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<collision><geometry><cylinder radius=".05" length=".4"/></geometry></collision>'
)
LEG = f"""<robot name="leg">
<link name="base">{BODY}</link><link name="shin">{BODY}</link><link name="foot">{BODY}</link>
<link name="plate">{BODY}</link>
<joint name="knee" type="revolute"><parent link="base"/><child link="shin"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
<joint name="ankle" type="fixed" dont_collapse="true"><parent link="shin"/><child link="foot"/></joint>
<joint name="mount" type="fixed"><parent link="base"/><child link="plate"/></joint></robot>"""


def leg(folder: Path, **options: object) -> Articulation:
    return leg_scene(folder, **options).articulations["leg"]


def leg_scene(folder: Path, **options: object) -> InteractiveScene:
    (folder / "leg.urdf").write_text(LEG)
    spawn = UrdfFileCfg(asset_path=str(folder / "leg.urdf"), **options)
    return make_scene({"leg": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Leg", spawn=spawn, actuators={})})


@pytest.mark.parametrize("fix_base", [False, True])
def test_bodies_are_merged_but_for_the_root_and_those_that_the_file_keeps(tmp_path, fix_base):
    robot = leg(tmp_path, fix_base=fix_base, merge_fixed_joints=True)
    assert (robot.body_names, robot.is_fixed_base) == (["base", "shin", "foot"], fix_base)
    assert robot.data.default_mass[0].tolist() == pytest.approx([2.0, 1.0, 1.0])  # the base has the plate's


def test_drives_have_the_gains_of_the_config(tmp_path):
    robot = leg(tmp_path, fix_base=True, joint_stiffness={"kn.*": 30.0}, joint_damping=2.0)
    assert (robot.data.joint_stiffness[0, 0].item(), robot.data.joint_damping[0, 0].item()) == (30.0, 2.0)


def test_cylinders_collide_as_capsules(tmp_path):
    model = leg_scene(tmp_path, fix_base=True, replace_cylinders_with_capsules=True).sim.model
    kinds, scales = model.shape_type.numpy(), model.shape_scale.numpy()
    assert set(kinds) == {int(newton.GeoType.CAPSULE)}
    assert scales[0, :2].tolist() == pytest.approx([0.05, 0.2])  # radius, half of the length between the caps' centres
