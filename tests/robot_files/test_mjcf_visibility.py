# SPDX-License-Identifier: Apache-2.0
"""Geoms that MuJoCo draws are drawn, also those that collide in a file with others that do not."""

import mujoco
import newton

from stripe_newton.robot_files import import_robot_file

FILE = """
<mujoco>
  <asset><mesh name="m" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset>
  <worldbody>
    <body name="trunk" pos="0 0 1"><freejoint/>
      <geom name="shell" type="box" size=".2 .1 .05"/>
      <geom name="only_for_contacts" type="sphere" size=".1" group="3"/>
      <body name="leg"><joint name="hip"/>
        <geom name="thigh" type="capsule" fromto="0 0 0 0 0 -.2" size=".02" contype="0" conaffinity="0"/>
        <geom name="foot" type="sphere" size=".03" pos="0 0 -.2"/>
        <geom name="clear" type="sphere" size=".03" rgba="1 1 1 0"/>
      </body>
      <body name="head"><joint name="neck"/>
        <geom name="face" type="mesh" mesh="m" contype="0" conaffinity="0"/>
        <geom name="hull_of_face" type="box" size=".1 .1 .1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def visible_shapes(path) -> set[str]:
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    import_robot_file(builder, "mjcf", path, {})
    shown = int(newton.ShapeFlags.VISIBLE)
    names = zip(builder.shape_label, builder.shape_flags, strict=True)
    return {label.rpartition("/")[2] for label, flags in names if int(flags) & shown}


def test_colliders_of_the_groups_that_mujoco_draws_are_visible(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(FILE)
    mujoco.MjModel.from_xml_path(str(path))
    # MuJoCo draws `hull_of_face`, too; it would hide the mesh that it approximates.
    assert visible_shapes(path) == {"shell", "thigh", "foot", "face"}


def test_a_file_without_decorations_is_as_before(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(FILE.replace('contype="0" conaffinity="0"', ""))
    assert {"shell", "thigh", "foot"} <= visible_shapes(path)
