# SPDX-License-Identifier: Apache-2.0
"""MJCF ``ref``: coordinates, limits, springs, targets and loops are those of the model that MuJoCo compiles."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import mujoco
import newton
import numpy as np
import pytest
import torch

from stripe_newton.assets import ArticulationCfg
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import MjcfFileCfg
from tests.helpers.small_scenes import make_scene, numpy, sim_cfg

AS_THE_FILE_SAYS = ArticulationCfg.InitialStateCfg(pos=None, rot=None, joint_pos=None)
DT = 0.001

MACHINE = """<mujoco><compiler angle="degree"/>
<worldbody><body name="base"><inertial pos="0 0 0" mass="3" diaginertia=".05 .06 .07"/>
<body name="thigh" pos="0.1 0 0">
<joint name="hip" axis="0 1 0" ref="40" range="-30 120" stiffness="3" springref="20" damping="0.1"/>
<inertial pos="0 0 -.2" mass="1" diaginertia=".01 .012 .013"/>
<body name="shin" pos="0 0 -.4"><joint name="knee" axis="0 1 0" ref="-58" range="-100 10" damping="0.1"/>
<inertial pos="0 0 -.1" mass="0.5" diaginertia=".004 .005 .003"/>
<body name="foot" pos="0 0.05 -.3"><joint name="lift" type="slide" axis="0 0 1" ref="0.2" range="0 .3" damping="0.1"/>
<joint name="yaw" axis="0 0 1" ref="30" damping=".1"/><joint name="roll" axis="1 0 0" ref="-20" damping=".1"/>
<inertial pos="0.02 0 -.1" mass="0.4" diaginertia=".004 .005 .003"/></body></body></body>
<body name="rod" pos="0.3 0 0"><joint name="crank" axis="0 1 0" ref="10" damping="0.1"/>
<inertial pos="0 0 -.2" mass="1" diaginertia=".01 .012 .013"/></body>
<body name="wheel" pos="0.6 0 0"><joint name="turn" axis="0 1 0" ref="25" damping="0.1"/>
<inertial pos="0 0 -.2" mass="1" diaginertia=".01 .012 .013"/></body>
</body></worldbody>
<equality>{equality}</equality>
<actuator><position joint="knee" kp="30" kv="1"/></actuator>
<keyframe><key name="bent" qpos="1 -1 .1 .2 -.3 0.4 .5"/></keyframe></mujoco>"""
"""Every kind of joint with a ``ref``: one a body, three on one body, and in two trees that a loop connects."""
CONNECT = '<connect body1="shin" body2="rod" anchor="0 0 0"/>'
WELD = '<weld body1="shin" body2="rod"/>'
GEARS = '<joint joint1="turn" joint2="crank" polycoef="0.1 0.7 0.2 0 0"/>'


def spawned(folder: Path, equality: str = "", keyframe: str | None = None) -> tuple[InteractiveScene, mujoco.MjModel]:
    """The scene of a file, and the model that MuJoCo makes of it."""
    path = folder / "machine.xml"
    path.write_text(MACHINE.format(equality=equality))
    return of_file(path, keyframe)


def of_file(path: Path, keyframe: str | None = None) -> tuple[InteractiveScene, mujoco.MjModel]:
    spawn = MjcfFileCfg(asset_path=str(path), keyframe=keyframe)
    robot = ArticulationCfg(prim_path="{ENV_REGEX_NS}/R", spawn=spawn, init_state=AS_THE_FILE_SAYS)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep, model.opt.integrator = DT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return make_scene({"robot": robot}, sim=sim_cfg(dt=DT)), model


def columns(scene: InteractiveScene, model: mujoco.MjModel) -> list[int]:
    """Index of each joint of the scene in MuJoCo's ``qpos``, where each of them has one."""
    return [int(model.joint(name).qposadr[0]) for name in scene["robot"].joint_names]


def test_coordinates_and_limits_are_those_of_the_file(tmp_path):
    scene, model = spawned(tmp_path)
    data, at = scene["robot"].data, columns(scene, model)
    np.testing.assert_allclose(numpy(data.joint_pos)[0], model.qpos0[at], atol=1e-6)
    np.testing.assert_allclose(numpy(data.joint_pos_target)[0], model.qpos0[at], atol=1e-6)
    limited = model.jnt_limited[at].astype(bool)
    assert limited.sum() == 3
    np.testing.assert_allclose(numpy(data.joint_pos_limits)[0][limited], model.jnt_range[at][limited], atol=1e-6)


def test_bodies_are_where_mujoco_puts_them_at_any_coordinates(tmp_path):
    scene, model = spawned(tmp_path)
    robot, state = scene["robot"], mujoco.MjData(model)
    values = np.random.default_rng(3).uniform(-1.5, 1.5, model.nq)
    robot.write_joint_state_to_sim(
        torch.tensor(values[columns(scene, model)], dtype=torch.float32).expand(2, -1), torch.zeros(2, model.nv)
    )
    scene.sim.forward()
    state.qpos[:] = values
    mujoco.mj_kinematics(model, state)
    start = scene.env_origins[0]
    for i, name in enumerate(robot.body_names):
        np.testing.assert_allclose(
            numpy(robot.data.body_pos_w[0, i] - start), state.body(name).xpos, atol=1e-5, err_msg=name
        )


@pytest.mark.filterwarnings("ignore:Joint equality:newton.NewtonWarning")
@pytest.mark.parametrize("equality", ["", GEARS, CONNECT, WELD, CONNECT + GEARS])
def test_motion_is_that_of_mujoco(tmp_path, equality):
    """Springs pull to the same pose, the servo to the same target, and a loop stays closed."""
    scene, model = spawned(tmp_path, equality)
    robot, state, at = scene["robot"], mujoco.MjData(model), columns(scene, model)
    target = numpy(robot.data.joint_pos_target)[0]
    target[robot.joint_names.index("knee")] += 0.3
    robot.set_joint_position_target(torch.tensor(target, dtype=torch.float32).expand(2, -1))
    state.ctrl[0] = model.qpos0[model.joint("knee").qposadr[0]] + 0.3
    scene.sim.step(200)
    for _ in range(200):
        mujoco.mj_step(model, state)
    moved = np.abs(state.qpos - model.qpos0).max()
    assert moved > 0.05
    np.testing.assert_allclose(numpy(robot.data.joint_pos)[0], state.qpos[at], atol=0.005)


@pytest.mark.parametrize("equality", [CONNECT, WELD])
def test_a_loop_stays_closed_after_the_solver_was_told_of_changes(tmp_path, equality):
    scene, _ = spawned(tmp_path, equality)
    scene.sim.notify(newton.ModelFlags.JOINT_PROPERTIES | newton.ModelFlags.JOINT_DOF_PROPERTIES)
    scene.sim.step(200)
    robot = scene["robot"]
    names = robot.body_names
    shin, rod = (robot.data.body_pos_w[0, names.index(n)] for n in ("shin", "rod"))
    # In the file the shin's origin is 0.2 m to the left of the rod's, and 0.4 m below it.
    distance = float(torch.linalg.vector_norm(shin - rod))
    assert distance == pytest.approx(np.hypot(0.2, 0.4), abs=0.002)


def test_a_keyframe_is_in_the_coordinates_of_the_file(tmp_path):
    scene, model = spawned(tmp_path, keyframe="bent")
    np.testing.assert_allclose(
        numpy(scene["robot"].data.joint_pos)[0], model.key_qpos[0][columns(scene, model)], atol=1e-6
    )


@pytest.mark.filterwarnings("ignore::newton.NewtonWarning")
@pytest.mark.parametrize("name", ["hopper", "walker2d_v5"])
def test_robots_of_gymnasium_stand_as_high_as_their_files_say(name):
    scene, model = of_file(Path(gymnasium.__file__).parent / f"envs/mujoco/assets/{name}.xml")
    data, at = scene["robot"].data, columns(scene, model)
    assert model.qpos0.max() == 1.25
    np.testing.assert_allclose(numpy(data.joint_pos)[0], model.qpos0[at], atol=1e-6)
    scene.sim.step(100)
    state = mujoco.MjData(model)
    for _ in range(100):
        mujoco.mj_step(model, state)
    np.testing.assert_allclose(numpy(data.joint_pos)[0], state.qpos[at], atol=0.01)


def test_what_newton_cannot_count_is_refused(tmp_path):
    path = tmp_path / "gimbal.xml"
    path.write_text(
        '<mujoco><worldbody><body name="b"><joint name="x" axis="1 0 0"/><joint name="y" axis="0 1 0" ref="30"/>'
        '<joint name="z" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body></worldbody>'
        "</mujoco>"
    )
    with pytest.raises(ValueError, match=r"gimbal\.xml.*ref=30 degrees of the second of three hinges.*axes oblique"):
        of_file(path)
