# SPDX-License-Identifier: Apache-2.0
"""A manager-based task in a file that is written for Isaac Lab 2.3."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.helpers.isaaclab_walker import put, walker_task
from tests.helpers.small_scenes import numpy

N = 6


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    with walker_task(tmp_path_factory.mktemp("walker")) as module:
        yield module


@pytest.fixture(scope="module")
def env(task: ModuleType) -> Iterator[Any]:
    made = task.ManagerBasedRLEnv(task.WalkerEnvCfg())
    yield made
    made.close()


def turns(quats: torch.Tensor) -> Rotation:
    return Rotation.from_quat(numpy(quats).astype(float), scalar_first=True)


def test_observations_in_wxyz(env):
    obs, _ = env.reset(seed=1)
    data, policy = env.scene["robot"].data, numpy(obs["policy"])
    assert env.observation_manager.active_terms["policy"] == ["joint_pos", "knees", "turn", "commands", "actions"]
    assert policy.shape == (N, 4 + 2 + 4 + 7 + 2)
    relative = numpy(data.joint_pos - data.default_joint_pos)
    knees = [i for i, name in enumerate(env.scene["robot"].joint_names) if name.endswith("knee")]
    np.testing.assert_allclose(policy[:, :4], relative, atol=1e-6)
    np.testing.assert_allclose(policy[:, 4:6], 2.0 * relative[:, knees], atol=1e-6)
    # The root was turned about its z from its default state, which is turned about y.
    start = Rotation.from_quat([0.0, 0.6, 0.0, 0.8])
    about = (start.inv() * turns(obs["policy"][:, 6:10])).as_rotvec()
    np.testing.assert_allclose(about[:, :2], 0.0, atol=1e-5)
    assert np.ptp(about[:, 2]) > 0.5
    assert set(obs["flags"]) == {"stands"}
    np.testing.assert_array_equal(numpy(obs["flags"]["stands"])[:, 0] > 0, numpy(data.root_pos_w[:, 2]) > 0.2)


def test_a_pose_command_in_wxyz(env):
    obs, _ = env.reset(seed=2)
    command = env.command_manager.get_command("pose")
    np.testing.assert_array_equal(numpy(obs["policy"][:, 10:17]), numpy(command))
    low, high = np.array([0.1, 0.3, 0.5]), np.array([0.3, 0.4, 0.6])
    assert ((numpy(command[:, :3]) >= low) & (numpy(command[:, :3]) <= high)).all()
    roll = turns(command[:, 3:]).as_rotvec()
    assert ((roll[:, 0] > 0.4) & (roll[:, 0] < 0.6)).all()
    np.testing.assert_allclose(roll[:, 1:], 0.0, atol=1e-6)
    term = env.command_manager.get_term("pose")
    np.testing.assert_array_equal(numpy(term.pose_command_b), numpy(command))


def test_a_users_action_term(env):
    env.reset(seed=3)
    actions = torch.rand(N, 2) - 0.5
    env.step(actions)
    robot = env.scene["robot"]
    target, default = robot.data.joint_pos_target, robot.data.default_joint_pos
    for side in ("left", "right"):
        ids, _ = robot.find_joints(f"{side}_.*")
        np.testing.assert_allclose(numpy(target[:, ids]), numpy(0.5 * actions + default[:, ids]), atol=1e-6)
    np.testing.assert_array_equal(numpy(env.action_manager.action), numpy(actions))
    np.testing.assert_array_equal(numpy(env.action_manager.get_term("legs").raw_actions), numpy(actions))
    assert env.action_manager.total_action_dim == 2
    obs = env.step(actions + 1.0)[0]
    np.testing.assert_array_equal(numpy(env.action_manager.prev_action), numpy(actions))
    np.testing.assert_array_equal(numpy(obs["policy"][:, -2:]), numpy(actions + 1.0))


def test_a_subclass_of_a_command_and_a_warp_reward_that_reads_it(env):
    env.reset(seed=4)
    term, data = env.command_manager.get_term("velocity"), env.scene["robot"].data
    for _ in range(8):
        before = term.vel_command_b.clone()
        reward = env.step(torch.zeros(N, 2))[1]
        assert reward.shape == (N,)
    moving = term.vel_command_b[~term.is_standing_env]
    assert ((moving[:, 0] >= 0.5) & (moving[:, 0] <= 1.0)).all()
    assert (term.vel_command_b[term.is_standing_env] == 0.0).all()
    heading = (term.is_heading_env & ~term.is_standing_env).numpy()
    error = np.angle(np.exp(1j * (numpy(term.heading_target - data.heading_w)).astype(float)))
    np.testing.assert_allclose(numpy(term.command[:, 2])[heading], error.clip(-1, 1)[heading], atol=1e-5)
    assert not torch.equal(before, term.vel_command_b)  # it was drawn anew within these steps
    put(env)
    std = env.reward_manager.get_term_cfg("tracks").params["std"]
    wanted, found = numpy(term.command[:, :2]), numpy(data.root_lin_vel_b[:, :2])
    expected = np.exp(-((wanted - found).astype(float) ** 2).sum(axis=1) / std**2)
    value = env.cfg.rewards.tracks.func
    tracked = env.evaluate(value, command_name="velocity", std=std)
    np.testing.assert_allclose(numpy(tracked), expected, rtol=1e-4, atol=1e-6)


def test_class_terms_and_curricula(task):
    """Terms that change the weight of a reward, a parameter of one, and the bounds of a command."""
    env = task.ManagerBasedRLEnv(task.WalkerEnvCfg())
    env.reset(seed=5)
    manager, data = env.reward_manager, env.scene["robot"].data
    assert manager.get_term_cfg("covered").weight == 2.0
    start = numpy(data.root_pos_w[:, 0]).copy()
    logs, ended = [], torch.zeros(N, dtype=torch.bool)
    for step in range(1, 27):
        _, reward, terminated, time_out, extras = env.step(torch.zeros(N, 2))
        if step == 1:
            weights = {name: manager.get_term_cfg(name).weight for name in manager.active_terms}
            wanted = numpy(env.command_manager.get_command("velocity"))
            assert weights == {"tracks": 1.0, "covered": 2.0, "alive": 1.0}
            covered = np.abs(numpy(data.root_pos_w[:, 0]) - start)
            others = numpy(reward) / env.step_dt - 2.0 * covered
            assert ((others >= 0.0) & (others <= 2.0)).all()
            assert covered.max() > 1e-3
            assert wanted.shape == (N, 3)
        ended |= terminated | time_out
        if (terminated | time_out).any():
            logs.append(extras["log"])
    assert ended.all()
    times = len(logs)
    assert manager.get_term_cfg("covered").weight == pytest.approx(2.0 * 0.5**times)
    assert manager.get_term_cfg("tracks").params["std"] == 0.9
    assert manager.get_term_cfg("alive").weight == 1.0  # the Warp curriculum changes the number on the device
    assert env.context.parameters["rewards.alive.weight"] == pytest.approx(3.0)
    assert env.context.parameters["rewards.tracks.std"] == pytest.approx(0.9)
    assert float(logs[-1]["Curriculum/halve"]) == pytest.approx(2.0 * 0.5**times)
    high = env.command_manager.get_term("pose").cfg.ranges.pos_x[1]
    assert high == pytest.approx(0.2 + 0.1 * times)
    np.testing.assert_allclose(env.context.parameters["commands.pose.ranges.pos_x"], (0.1, high), rtol=1e-6)
    env.close()


def test_some_environments_begin_anew(env):
    env.reset(seed=6)
    for _ in range(3):
        env.step(torch.zeros(N, 2))
    assert env.episode_length_buf.tolist() == [3] * N
    before = numpy(env.scene["robot"].data.joint_pos).copy()
    env.reset(env_ids=[1, 4])
    assert env.episode_length_buf.tolist() == [3, 0, 3, 3, 0, 3]
    same = (numpy(env.scene["robot"].data.joint_pos) == before).all(axis=1)
    assert same.tolist() == [True, False, True, True, False, True]


def test_terms_are_copied_and_pickled(task):
    cfg = task.WalkerEnvCfg()
    assert cfg.copy().rewards.alive.func is cfg.rewards.alive.func
    assert copy.deepcopy(cfg.rewards.alive).func is cfg.rewards.alive.func
    assert pickle.loads(pickle.dumps(cfg.rewards.alive)).func is cfg.rewards.alive.func
    assert cfg.rewards.alive.to_dict()["func"]


def test_a_term_of_an_environment_without_rewards(task):
    """``ManagerBasedEnv``: observations, actions and events alone."""
    from isaaclab.envs import ManagerBasedEnv, ManagerBasedEnvCfg

    full = task.WalkerEnvCfg()
    cfg = ManagerBasedEnvCfg(decimation=2, scene=full.scene, actions=full.actions, events=full.events)
    cfg.observations = {"seen": full.observations.policy}
    full.observations.policy.commands = full.observations.policy.knees = None
    cfg.sim = full.sim
    env = ManagerBasedEnv(cfg)
    env.reset()
    obs, extras = env.step(torch.zeros(N, 2))
    assert obs["seen"].shape == (N, 4 + 4 + 2)
    assert isinstance(extras, dict)
    env.close()
