# SPDX-License-Identifier: Apache-2.0
"""MJCF frames and bodies without names: joints, bodies and keyframes are those of MuJoCo."""

from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest

from stripe_newton.robot_files.importing import import_robot_file

GEOM = '<geom size="0.1" pos="0.1 0.05 0"/>'
FRAMES = f"""<mujoco><compiler angle="degree"/>
<default><default class="stiff"><joint stiffness="7"/></default></default><worldbody>
<frame pos="0 0 1" euler="30 0 0">
  <body name="first" euler="0 20 0" pos="1 0 0">{GEOM}
    <joint name="b" type="slide" axis="0 0 1"/>
    <frame euler="0 0 40" childclass="stiff"><frame pos="0.1 0.2 0.3">
      <joint name="a" axis="0 1 0" pos="0 0 0.1"/>
      <body name="inner" axisangle="1 0 0 15" pos="0 0.3 0">{GEOM}<joint name="c" axis="1 1 0"/></body>
    </frame></frame>
    <body pos="0 0 0.4"><joint name="d" axis="1 0 0"/>{GEOM}</body>
  </body>
</frame>
<body pos="0 2 0"><frame pos="1 1 1"><freejoint name="f"/></frame>{GEOM}</body>
</worldbody></mujoco>"""


def imported(text: str, folder: Path, **options: object) -> tuple[newton.ModelBuilder, mujoco.MjModel, list[str]]:
    path = folder / "robot.xml"
    path.write_text(text)
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    report = import_robot_file(builder, "mjcf", path, options)
    return builder, mujoco.MjModel.from_xml_path(str(path)), [f"{what}: {why}" for _, what, why in report.ignored]


def test_joints_and_bodies_in_frames_are_where_mujoco_has_them(tmp_path: Path) -> None:
    builder, theirs, _ = imported(FRAMES, tmp_path)
    solver = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu"), use_mujoco_cpu=True)
    ours = solver.mj_model
    assert (ours.nbody, ours.njnt, ours.nv) == (theirs.nbody, theirs.njnt, theirs.nv)
    np.testing.assert_allclose(ours.body_mass, theirs.body_mass, rtol=1e-5)
    assert list(ours.jnt_type) == list(theirs.jnt_type)
    np.testing.assert_allclose(ours.jnt_stiffness, theirs.jnt_stiffness, rtol=1e-6)
    assert list(theirs.jnt_stiffness) == [0.0, 7.0, 7.0, 0.0, 0.0]
    one, two = mujoco.MjData(ours), mujoco.MjData(theirs)
    one.qpos[:] = two.qpos[:] = [0.3, -0.4, 0.5, 0.6, 0.1, 0.2, 0.3, 0.5, 0.5, 0.5, 0.5]
    for model, data in ((ours, one), (theirs, two)):
        mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(one.xipos, two.xipos, atol=1e-6)
    named = [label.rpartition("/")[2] for label in builder.joint_label]
    assert named == ["b+a", "c", "d", "f"]


NAMELESS = f"""<mujoco><worldbody>
<body pos="0 0 1"><joint name="hip_z" axis="0 0 1"/><joint name="hip_y" axis="0 1 0"/>{GEOM}
  <body pos="0.3 0 0"><joint name="knee" axis="0 1 0"/>{GEOM}</body></body></worldbody>
<tendon><fixed name="tie"><joint joint="hip_y" coef="1"/><joint joint="knee" coef="1"/></fixed></tendon>
<keyframe><key name="bent" qpos="0.1 0.2 0.3"/></keyframe></mujoco>"""


def test_bodies_without_names_keep_the_names_of_their_joints_and_take_keyframes(tmp_path: Path) -> None:
    builder, _, rows = imported(NAMELESS, tmp_path, keyframe="bent")
    assert [label.rpartition("/")[2] for label in builder.joint_label] == ["hip_z+hip_y", "knee"]
    assert list(builder.joint_q) == pytest.approx([0.1, 0.2, 0.3])
    assert [row for row in rows if row.startswith("tendon: hip_y of the tendon left out")]
