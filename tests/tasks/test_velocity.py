# SPDX-License-Identifier: Apache-2.0
"""Velocity tasks: observations, terminations, and agreement of their forms."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest
import torch
import warp as wp

import stripe_tasks  # noqa: F401
from stripe_kernels.data import VelocityCommandData
from tests.helpers.small_tasks import small_cfg

N = 8
SIZES = {"Quadruped": (48, 12), "Humanoid": (75, 21)}
FALLEN = {"Quadruped": "base", "Humanoid": "torso"}
ROBOTS = list(SIZES)


def config(task: str, num_envs: int = N) -> Any:
    return small_cfg(task, num_envs, seed=4)


def make(task: str, cfg: Any = None) -> Any:
    return gymnasium.make_vec(task, cfg=cfg or config(task))


@pytest.fixture(scope="module", params=ROBOTS)
def forms(request):
    """The robot, its manager-based form and its direct one, without pushes and all alike."""
    managed = config(f"Stripe-Velocity-Flat-{request.param}-v0")
    for name in ("push_robot", "payload", "centre_of_mass", "soles"):
        setattr(managed.events, name, None)
    direct = config(f"Stripe-Velocity-Flat-{request.param}-Direct-Warp-v0")
    direct.push_interval_s = (1e3, 1e3)
    tasks = f"Stripe-Velocity-Flat-{request.param}-v0", f"Stripe-Velocity-Flat-{request.param}-Direct-Warp-v0"
    envs = [make(task, cfg) for task, cfg in zip(tasks, (managed, direct), strict=True)]
    yield request.param, *envs
    for env in envs:
        env.close()


def put_same(one: Any, two: Any) -> None:
    """Give the second the state, the command and the heading of the first."""
    for name in ("joint_q", "joint_qd"):
        getattr(two.sim.state, name).assign(getattr(one.sim.state, name))
    two.sim.forward()
    (mine,) = one.context.structs.provided[VelocityCommandData].values()
    for name in ("command", "heading_target", "is_heading", "is_standing"):
        getattr(two._task.command, name).assign(getattr(mine, name))


def test_forms_agree_step_by_step_until_an_episode_ends(forms):
    robot, managed, direct = forms
    managed.reset(seed=1)
    direct.reset(seed=2)
    put_same(managed, direct)
    generator = torch.Generator().manual_seed(0)
    running, compared, landed = torch.ones(N, dtype=torch.bool), 0, 0.0
    for _ in range(60):
        actions = 2.0 * torch.randn(N, SIZES[robot][1], generator=generator)
        results = [env.step(actions) for env in (managed, direct)]
        (obs, reward, done, late, _), (obs_2, reward_2, done_2, late_2, _) = results
        torch.testing.assert_close(reward_2[running], reward[running], atol=2e-4, rtol=2e-3)
        assert torch.equal(done[running], done_2[running])
        running &= ~(done | late | done_2 | late_2)
        torch.testing.assert_close(obs_2["critic"][running], obs["critic"][running], atol=5e-3, rtol=5e-3)
        compared += int(running.sum())
        landed += float(wp.to_torch(managed.scene["contact_forces"].struct.last_air_time).sum())
    assert compared > 10 * N
    assert landed > 0.0


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("ground", ["Flat", "Rough"])
def test_task_runs_and_falls_end_episodes(robot, ground):
    env = make(f"Stripe-Velocity-{ground}-{robot}-v0")
    size, joints = SIZES[robot]
    size += 187 if ground == "Rough" else 0
    masses = env.sim.per_env(env.sim.model.body_mass)
    assert (masses.std(dim=0) > 0.2).sum() == 1, "one body has a payload"
    obs, _ = env.reset(seed=3)
    assert {k: tuple(v.shape) for k, v in obs.items()} == {"policy": (N, size), "critic": (N, size)}
    for _ in range(25):
        obs, reward, terminated, _, _ = env.step(torch.zeros(N, joints))
        assert not terminated.any(), "it stands by itself"
    gravity = obs["critic"][:, 6:9]
    assert (gravity[:, 2] < -0.9).all()
    assert torch.isfinite(reward).all()
    data = env.scene["robot"].data
    pose = data.root_pose_w.clone()
    if ground == "Rough":
        aside = pose.clone()
        aside[:, 0] += 2.0  # off the level middle of the tile
        env.scene["robot"].write_root_pose_to_sim(aside)
        heights = env.step(torch.zeros(N, joints))[0]["critic"][:, SIZES[robot][0] :]
        assert (heights.abs() <= 1.0).all()
        assert (heights.std(dim=1) > 0.005).sum() > N // 2
    pose[::2, 3:] = torch.tensor([1.0, 0.0, 0.0, 0.0])  # on its back
    env.scene["robot"].write_root_pose_to_sim(pose)
    env.scene["robot"].write_root_velocity_to_sim(torch.zeros(N, 6))
    ended = torch.zeros(N, dtype=torch.bool)
    for _ in range(60):
        ended |= env.step(torch.zeros(N, joints))[2]
    assert ended[::2].all()
    assert not ended[1::2].any()
    env.close()


def test_noise_is_on_what_the_policy_sees_alone():
    for form in ("", "-Direct-Warp"):
        env = make(f"Stripe-Velocity-Flat-Quadruped{form}-v0")
        env.reset(seed=0)
        obs = env.step(torch.zeros(N, 12))[0]
        off = (obs["policy"] - obs["critic"]).abs()
        bounds = torch.tensor([0.1] * 3 + [0.2] * 3 + [0.05] * 3 + [0.0] * 3 + [0.01] * 12 + [1.5] * 12 + [0.0] * 12)
        assert (off <= bounds + 1e-6).all()
        assert (off.amax(dim=0)[bounds > 0] > 0.2 * bounds[bounds > 0]).all()
        env.close()
