# SPDX-License-Identifier: Apache-2.0
"""Fusion gain: fused kernels against a kernel for each term."""

from __future__ import annotations

import pytest
import torch
import warp as wp

from stripe_kernels import mdp
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.configclass import configclass
from stripe_newton.envs import fusion_gain as fusion_gain_module
from stripe_newton.envs.fusion_gain import fused_kernels, fusion_gain, launch_us, term_configs
from stripe_newton.envs.measure import random_actions
from stripe_newton.envs.step_times import LEAD, measure_step
from stripe_newton.managers import RewardManager, RewardTermCfg, TerminationManager, TerminationTermCfg
from tests.helpers.counting_clock import CountingClock
from tests.helpers.manager_world import manager_context


@pytest.fixture(scope="module")
def managers():
    context = manager_context(num_envs=3, num_terminations=2)
    height = {"minimum_height": 0.3}
    terminations = {
        "time_out": TerminationTermCfg(func=mdp.time_out, time_out=True),
        "low": TerminationTermCfg(func=mdp.root_height_below_minimum, params=height),
    }
    rewards = {
        "alive": RewardTermCfg(func=mdp.is_alive, weight=2.0),
        "off": None,
        "speed": RewardTermCfg(func=mdp.joint_vel_l2, weight=-0.5),
        "climb": RewardTermCfg(func=mdp.lin_vel_z_l2, weight=-1.0),
    }
    made = TerminationManager(terminations, context), RewardManager(rewards, context)
    wp.to_torch(context.entity("robot").data.struct.joint_vel)[:] = torch.rand(3, 8)
    yield made
    context.scene.close()


def test_terms_apart_compute_what_the_fused_ones_do(managers):
    _, rewards = managers
    reward = rewards.context.torch(rewards.context.reward)

    def result(cfg) -> tuple[int, torch.Tensor]:
        kernels = fused_kernels([rewards], [cfg])
        for kernel in kernels:
            kernel.launch()
        return len(kernels), reward.clone()

    count, fused = result(rewards.cfg)
    apart = [result(cfg) for cfg in term_configs(rewards.cfg)]
    assert count == 1
    assert [kernels for kernels, _ in apart] == [1, 1, 1]
    assert fused.abs().min() > 0.0
    torch.testing.assert_close(sum(value for _, value in apart), fused)


def test_the_sums_of_the_environment_are_left_alone(managers):
    _, rewards = managers
    for kernel in fused_kernels([rewards], [rewards.cfg]):
        kernel.launch()
    assert all(not values.any() for values in rewards.episode_sums.values())


def test_groups_are_taken_apart_too():
    terms = {name: RewardTermCfg(func=mdp.is_alive, weight=1.0) for name in "ab"}

    @configclass
    class Group:
        a: RewardTermCfg = terms["a"]
        b: RewardTermCfg = terms["b"]
        size = 3

    @configclass
    class Groups:
        policy: Group = Group()
        critic: Group = Group(a=None)
        none = None

    found = [
        (name, [t for t in "ab" if getattr(group, t)]) for cfg in term_configs(Groups()) for name, group in cfg.items()
    ]
    assert found == [("policy", ["a"]), ("policy", ["b"]), ("critic", ["b"])]


def test_a_manager_based_task_is_measured_in_both_ways():
    cfg = load_cfg("Stripe-Cartpole-v0", "env")
    cfg.scene.num_envs, cfg.sim.device = 4, "cpu"
    env = make_env("Stripe-Cartpole-v0", cfg)
    env.reset(seed=1)
    assert measure_step(env, random_actions(env, LEAD + 8), blocks=1).replay_difference == 0.0
    gain = fusion_gain(env, rounds=1)
    observations, rewards, ends = (
        getattr(env, f"{kind}_manager").active_terms for kind in ("observation", "reward", "termination")
    )
    counts = {"observations": len(observations["policy"]), "rewards": len(rewards), "terminations": len(ends)}
    assert {name: entry["terms"] for name, entry in gain.items()} == {**counts, "all": sum(counts.values())}
    assert all(entry["fused_us"] > 0.0 and entry["apart_us"] > 0.0 for entry in gain.values())
    env.close()


def test_launches_are_timed_one_by_one(monkeypatch):
    calls = []
    monkeypatch.setattr(fusion_gain_module, "Clock", CountingClock)

    def launch() -> None:
        calls.append(1)
        CountingClock.count += 1

    assert launch_us("cpu", [launch, launch], rounds=3, repeats=5) == 2000.0
    assert len(calls) == 2 * (1 + 2 * 3 * 5)
