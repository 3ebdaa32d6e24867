# SPDX-License-Identifier: Apache-2.0
"""Joints in another order, other names and split-off links change no motion."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import ConfigError
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import MjcfFileCfg, ModelNamesCfg, MuJoCoSolverCfg
from tests.helpers.robot_files import robot_file
from tests.helpers.small_scenes import make_scene, numpy, sim_cfg

TREE = """
<mujoco>
  <option integrator="implicitfast"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <default class="bone"><geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/></default>
  </default>
  <worldbody>
    <body name="trunk" pos="0 0 1">
      {root}
      <geom type="box" size=".1 .1 .02"/>
      <body name="left_leg" pos="0 .1 0"><joint name="left_hip" axis="0 1 0" damping=".1"/><geom class="bone"/>
        <body name="left_shin" pos="0 0 -.2"><joint name="left_knee" axis="0 1 0" armature=".01" stiffness="2"/>
          <geom class="bone"/><geom name="left_sole" type="sphere" pos="0 0 -.205" size=".03"/></body></body>
      <body name="arm" pos=".1 0 0"><joint name="lift" type="slide" axis="0 0 1" range="-.1 .1"/>
        <joint name="swing" axis="1 0 0"/><geom class="bone"/></body>
      <body name="right_leg" pos="0 -.1 0"><joint name="right_hip" axis="0 1 0" frictionloss=".05"/><geom class="bone"/>
        <body name="right_shin" pos="0 0 -.2"><joint name="right_knee" axis="0 1 0"/><geom class="bone"/>
          <geom name="right_sole" type="sphere" pos="0 0 -.205" size=".03"/></body></body>
    </body>
  </worldbody>
  <equality><joint joint1="left_knee" joint2="right_knee" polycoef=".1 .5 0 0 0"/></equality>
  <tendon><fixed name="hips"><joint joint="left_hip" coef="1"/><joint joint="right_hip" coef="-2"/></fixed></tendon>
  <actuator>
    <position name="servo" joint="right_knee" kp="3"/>
    <general name="pull" tendon="hips" gainprm="2" biasprm="1 -4 -1" biastype="affine"/>
  </actuator>
</mujoco>
"""
BY_DEPTH = ["left_hip", "lift", "swing", "right_hip", "left_knee", "right_knee"]


@pytest.fixture(params=["", "<freejoint/>"], ids=["fixed", "floating"])
def tree(request, tmp_path):
    """File of a robot with two legs and an arm, coupled by an equality, a tendon and actuators."""
    path = tmp_path / "tree.xml"
    path.write_text(TREE.format(root=request.param))
    return path


def build(path, order="file", solver=None, **options) -> InteractiveScene:
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot",
        spawn=MjcfFileCfg(asset_path=str(path), **options),
        init_state=ArticulationCfg.InitialStateCfg(pos=None, rot=None, joint_pos=None),
        joint_order=order,
    )
    return make_scene({"robot": robot}, sim=sim_cfg(dt=0.002, solver=solver or MuJoCoSolverCfg()))


def motion(scene: InteractiveScene, steps: int = 100) -> dict[str, np.ndarray]:
    """What follows from some velocities and efforts, by name of joint and body."""
    robot = scene["robot"]
    names = sorted(robot.joint_names)
    ids = robot.find_joints(names, preserve_order=True)[0]
    values = torch.linspace(-1.0, 1.0, len(names)).repeat(robot.num_instances, 1)
    robot.write_joint_velocity_to_sim(0.5 * values, joint_ids=ids)
    robot.set_joint_effort_target(0.2 * values, joint_ids=ids)
    scene.sim.step(steps)
    joints = {n: numpy(robot.data.joint_pos)[:, i] for i, n in enumerate(robot.joint_names)}
    return joints | {n: numpy(robot.data.body_pose_w)[:, i] for i, n in enumerate(robot.body_names)}


@pytest.mark.parametrize("fused", [False, True])
def test_joints_and_bodies_come_by_depth_and_the_motion_is_that_of_the_file_order(tree, fused):
    solver = MuJoCoSolverCfg(fused=fused)
    plain, ordered = build(tree, solver=solver), build(tree, "breadth_first", solver)
    robot = ordered["robot"]
    assert robot.joint_names == BY_DEPTH
    assert robot.body_names == ["trunk", "left_leg", "arm", "right_leg", "left_shin", "right_shin"]
    expected, found = motion(plain), motion(ordered)
    assert expected.keys() == found.keys()
    assert max(np.abs(expected["left_knee"])) > 0.05
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=2e-6, err_msg=name)


def test_the_motion_is_that_of_plain_mujoco(tree):
    scene = build(tree, "breadth_first")
    model = mujoco.MjModel.from_xml_path(str(tree))
    data = mujoco.MjData(model)
    model.opt.timestep = 0.002
    names = sorted(scene["robot"].joint_names)
    for value, name in zip(np.linspace(-1.0, 1.0, len(names)), names, strict=True):
        dof = model.joint(name).dofadr[0]
        data.qvel[dof], data.qfrc_applied[dof] = 0.5 * value, 0.2 * value
    mujoco.mj_step(model, data, 100)
    found = motion(scene)
    for name in names:
        assert found[name][0] == pytest.approx(data.joint(name).qpos[0], abs=2e-4), name


@pytest.mark.parametrize("name", ["go1", "shadow_hand"])
def test_robots_of_others_move_the_same_in_either_order(name):
    path = robot_file(name)
    solver = MuJoCoSolverCfg(njmax=500, nconmax=500)
    plain, ordered = (build(path, order, solver, fix_base=True) for order in ("file", "breadth_first"))
    expected, found = motion(plain, 20), motion(ordered, 20)
    assert expected.keys() == found.keys()
    for key, values in expected.items():
        np.testing.assert_allclose(found[key], values, atol=2e-5, err_msg=key)


def test_an_order_by_name_is_kept_and_an_unknown_name_is_refused(tree):
    order = ["right_hip", "right_knee", "lift+swing", "left_hip", "left_knee"]
    scene = build(tree, order)
    assert scene["robot"].joint_names == ["right_hip", "right_knee", "lift", "swing", "left_hip", "left_knee"]
    with pytest.raises(ConfigError, match=r"no joint elbow; there is .*left_hip"):
        build(tree, ["elbow"])
    with pytest.raises(ConfigError, match="must be 'file', 'breadth_first' or names"):
        build(tree, "depth")


def test_names_are_those_of_the_config_and_soles_are_bodies(tree):
    names = ModelNamesCfg(
        joints={r"(left|right)_(hip|knee)": r"\2_\1", "swing": "wave"},
        bodies={r"(left|right)_shin": r"\1_calf"},
        links={r"(left|right)_shin": (r"\1_foot", r"\1_sole")},
    )
    plain, renamed = build(tree), build(tree, "breadth_first", names=names)
    robot = renamed["robot"]
    assert robot.joint_names == ["hip_left", "hip_right", "lift", "wave", "knee_left", "knee_right"]
    assert robot.body_names[-4:] == ["left_calf", "right_calf", "left_foot", "right_foot"]
    feet = robot.find_bodies(".*_foot")[0]
    assert robot.data.body_mass[0, feet].tolist() == [0.0, 0.0]
    assert float(robot.data.body_mass[0].sum()) == pytest.approx(float(plain["robot"].data.body_mass[0].sum()))
    plain.sim.step(100)
    renamed.sim.step(100)
    shins, soles = plain["robot"].data.body_pose_w[0, [2, 5]], robot.data.body_pose_w[0, feet]
    assert torch.allclose(robot.data.body_pose_w[0, robot.find_bodies(".*_calf")[0]], shins, atol=1e-6)
    distance = torch.linalg.vector_norm(soles[:, :3] - shins[:, :3], dim=-1)
    assert torch.allclose(distance, torch.full((2,), 0.205), atol=1e-5)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"joints": {"hip": "x"}}, r"joints: 'hip' matches nothing; did you mean left_hip, right_hip\?"),
        ({"bodies": {".*_leg": "leg"}}, "left_leg, right_leg would all be 'leg'"),
        ({"links": {"trunk": ("foot", "toe")}}, "links: 'toe' matches no shape of 'trunk', which has trunk_geom_0"),
        ({"links": {"foot": ("a", "b")}}, "links: 'foot' matches no body"),
    ],
)
def test_names_that_do_not_fit_are_refused(tree, names, message):
    with pytest.raises(ValueError, match=message):
        build(tree, names=ModelNamesCfg(**names))


def test_a_file_without_its_actuators_and_root_pose(tree):
    scene = build(tree, actuators=False, root_pose=(0, 0, 0, 0, 0, 0, 1))
    robot = scene["robot"]
    start = robot.data.root_pos_w - torch.as_tensor(scene.env_origins)
    assert torch.allclose(start, torch.zeros(2, 3), atol=1e-6)
    assert robot.data.joint_stiffness.abs().max() == 0.0
    assert any("not read" in row[1] and "actuators" in row[0] for row in scene.builder.reports[0].ignored)
