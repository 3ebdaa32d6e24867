# SPDX-License-Identifier: Apache-2.0
"""Scripted hands: the lift and the cabinet can be solved, and solving them is what earns most."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stripe_tasks  # noqa: F401
from stripe_tasks.manipulation.cabinet_model import HANDLE
from tests.helpers.panda_arm import DOWN, PandaArm
from tests.helpers.robot_files import robot_file
from tests.helpers.small_tasks import small_cfg

pytestmark = pytest.mark.slow
N = 4


def make(task: str) -> Any:
    env = gymnasium.make_vec(task, cfg=small_cfg(task, N, seed=4))
    env.reset(seed=1)
    return env


def rest(env: Any, arm: PandaArm, gripper: float) -> None:
    """Hold until the last step of the episodes."""
    for _ in range(int(env.max_episode_length) - 1 - int(env.episode_length_buf[0])):
        arm.step(gripper)


def grasped() -> tuple[Any, PandaArm]:
    """A lift in which all cubes are between closed fingers."""
    env = make("Stripe-Lift-Cube-Panda-v0")
    arm = PandaArm(env, robot_file("panda"), scale=0.5, stiffness=80.0)
    cube = env.scene["object"].data.root_pos_w.numpy() - env.scene.env_origins.numpy()
    arm.rotation = DOWN
    arm.move(cube + [0.0, 0.0, 0.1], 0.5, gripper=1.0)
    arm.move(cube.astype(float), 0.3, gripper=1.0)
    for _ in range(10):
        arm.step(-1.0)
    return env, arm


def test_a_cube_is_lifted_to_its_goal_and_earns_more_than_one_that_is_thrown_up():
    env, arm = grasped()
    arm.move(env.command_manager.get_command("object_pose")[:, :3].numpy().astype(float), 0.5, gripper=-1.0)
    rest(env, arm, -1.0)
    assert env.success.all()
    held = arm.total
    env.close()
    env, arm = grasped()
    up = arm.tip + [0.0, 0.0, 0.25]
    arm.move(up, 1.5, gripper=-1.0, pause=0)
    rest(env, arm, 1.0)
    assert not env.success.any()
    assert held.min() > 2.0 * arm.total.max(), (held, arm.total)
    env.close()


def test_a_drawer_is_pulled_open_by_its_handle():
    env = make("Stripe-Open-Cabinet-Panda-v0")
    arm = PandaArm(env, robot_file("panda"), scale=1.0, stiffness=80.0)
    drawers = env.scene["cabinet"]
    index = drawers.find_bodies("drawer_top")[0][0]
    pose = drawers.data.body_pose_w[:, index].numpy().astype(float)
    handle = pose[:, :3] + Rotation.from_quat(pose[:, 3:]).apply(HANDLE) - env.scene.env_origins.numpy()
    # Into the drawer and a little down, one finger above the handle and the other below it.
    forward = np.stack(([0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]), axis=1)
    arm.turn(Rotation.from_euler("y", 25.0, degrees=True).as_matrix() @ forward, steps=100)
    arm.move(handle - [0.12, 0.0, 0.0], 0.5, gripper=1.0, pause=20)
    arm.move(handle.astype(float), 0.25, gripper=1.0, pause=20)
    for _ in range(20):
        arm.step(-1.0)
    reached = arm.total.copy()
    arm.move(handle - [0.36, 0.0, 0.0], 0.25, gripper=-1.0)
    rest(env, arm, -1.0)
    assert env.success.all()
    assert (drawers.data.joint_pos[:, 1] > 0.33).all()
    assert (arm.total > 2.0 * reached).all()
    env.close()
