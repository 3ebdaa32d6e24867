# SPDX-License-Identifier: Apache-2.0
"""Motion library: bodies of a robot against MuJoCo's own forward kinematics, and frames in bins."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from stripe_newton.motions import Motion, MotionError, MotionLibrary
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import Simulation, SimulationCfg
from stripe_tasks.published_robots import g1_cfg
from tests.helpers.motion_files import smooth_motion
from tests.helpers.robot_files import robot_file

FPS = 50.0


@pytest.fixture(scope="module")
def g1():
    """The G1 in three environments, and MuJoCo's model of it."""
    path = robot_file("g1")
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=3, env_spacing=2.0), Simulation(SimulationCfg(device="cpu")))
    scene.builder.build_robot("robot", g1_cfg().replace(prim_path="{ENV_REGEX_NS}/Robot"))
    scene.build()
    return scene, mujoco.MjModel.from_xml_path(str(path))


def motion_of(fps: float, seconds: float, seed: int, joints: int = 29) -> Motion:
    times = np.arange(round(seconds * fps) + 1) / fps
    return Motion(f"motion {seed}", fps, *smooth_motion(times, [0.1] * joints, seed))


def poses_by_mujoco(model: mujoco.MjModel, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, quaternions (x, y, z, w) and centres of mass of all bodies, (num_frames, num_bodies, ...)."""
    data, found = mujoco.MjData(model), []
    for pos, quat, joints in zip(motion.root_pos, motion.root_quat, motion.joint_pos, strict=True):
        data.qpos[:] = np.concatenate((pos, np.roll(quat, 1), joints))
        mujoco.mj_kinematics(model, data)
        found.append((data.xpos[1:].copy(), np.roll(data.xquat[1:], -1, axis=1), data.xipos[1:].copy()))
    return tuple(np.stack(part) for part in zip(*found, strict=True))


def test_bodies_are_where_mujoco_puts_them_and_move_as_they_do(g1):
    scene, model = g1
    robot, motion = scene["robot"], motion_of(FPS, 1.5, 0)
    before = scene.sim.state.joint_q.numpy().copy()
    library = MotionLibrary.of_robot([motion], robot, scene.sim, FPS)
    pos, quat, com = poses_by_mujoco(model, motion)
    assert [model.body(i + 1).name for i in range(model.nbody - 1)] == robot.data.body_names
    np.testing.assert_allclose(library.body_pose[..., :3], pos, atol=2e-6)
    sign = np.sign((library.body_pose[..., 3:] * quat).sum(axis=-1, keepdims=True))
    np.testing.assert_allclose(library.body_pose[..., 3:], sign * quat, atol=2e-6)
    # Central differences of MuJoCo's centres of mass: both are off by the third derivative, times 1 / (6 fps^2).
    moved = (com[2:] - com[:-2]) * FPS / 2.0
    np.testing.assert_allclose(library.body_vel[1:-1, :, :3], moved, atol=0.03)
    assert np.abs(moved).max() > 1.0
    np.testing.assert_array_equal(scene.sim.state.joint_q.numpy(), before)


def test_motions_of_several_rates_lie_one_after_the_other_in_bins(g1):
    scene, _ = g1
    motions = [motion_of(60.0, 2.5, 1), motion_of(30.0, 0.4, 2)]
    library = MotionLibrary.of_robot(motions, scene["robot"], scene.sim, FPS)
    assert library.lengths == [126, 21]
    np.testing.assert_array_equal(library.starts, [0, 126])
    np.testing.assert_array_equal(np.unique(library.last), [125, 146])
    starts, sizes, owners = library.bins()
    np.testing.assert_array_equal(starts, [0, 62, 126])
    np.testing.assert_array_equal(sizes, [62, 63, 20])
    np.testing.assert_array_equal(owners, [0, 0, 1])
    bins = library.bin_of_frames()
    assert all((bins[s : s + n] == i).all() for i, (s, n) in enumerate(zip(starts, sizes, strict=True)))
    assert (bins[125], bins[146]) == (1, 2)
    np.testing.assert_allclose(library.joint_pos[126], motions[1].joint_pos[0], atol=1e-6)


def test_another_robot_or_order_of_joints_is_told(g1):
    scene, model = g1
    robot, motion = scene["robot"], motion_of(FPS, 0.2, 3)
    few = Motion("few", FPS, motion.root_pos, motion.root_quat, motion.joint_pos[:, :23])
    with pytest.raises(MotionError, match="few: has 23 joints, the robot has 29"):
        MotionLibrary.of_robot([few], robot, scene.sim, FPS)
    pos, _, _ = poses_by_mujoco(model, motion)
    order = np.roll(np.arange(29), 6)
    names = tuple(robot.joint_names[i] for i in order)
    mixed = Motion("mixed", FPS, motion.root_pos, motion.root_quat, motion.joint_pos[:, order] + 0.5, body_pos=pos)
    with pytest.raises(MotionError, match=r"mixed: bodies are .* m from where its joints"):
        MotionLibrary.of_robot([mixed], robot, scene.sim, FPS)
    right = Motion("right", FPS, motion.root_pos, motion.root_quat, motion.joint_pos[:, order], names, pos)
    library = MotionLibrary.of_robot([right], robot, scene.sim, FPS)
    np.testing.assert_allclose(library.body_pose[..., :3], pos, atol=2e-6)
    short = Motion("short", 1000.0, motion.root_pos[:3], motion.root_quat[:3], motion.joint_pos[:3])
    with pytest.raises(MotionError, match=r"short: lasts 0\.002 s, must last 0\.02 s"):
        MotionLibrary.of_robot([short], robot, scene.sim, FPS)
