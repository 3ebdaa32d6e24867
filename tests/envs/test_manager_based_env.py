# SPDX-License-Identifier: Apache-2.0
"""ManagerBasedRLEnv: order of a step, resets, outputs, seeds, saved state, the log."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    MetricTermCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.rl import OnPolicyRunner, RslRlVecEnvWrapper
from stripe_tasks.cartpole.manager_based import (
    CART,
    POLE,
    CartpoleManagerPPORunnerCfg,
    EventsCfg,
    ObservationsCfg,
    RewardsCfg,
    TerminationsCfg,
)
from tests.helpers.cartpole_manager_env import (
    DT,
    N,
    actions_of,
    config,
    make,
    put,
    rich,
    rollout,
)


def assert_equal(one: list[tuple[Any, ...]], two: list[tuple[Any, ...]]) -> None:
    for step, (a, b) in enumerate(zip(one, two, strict=True)):
        for what, x, y in zip(("observations", "rewards", "terminated", "truncated", "rng"), a, b, strict=True):
            assert torch.equal(x, y), f"{what} of step {step}: {x} and {y}"


# -- a step


def test_order_of_a_step():
    """Rewards and ends are of the state before the reset, observations of the new episode, lengths start anew."""
    env = make(compute_final_obs=True, steps=10)
    env.reset(seed=0)
    env.episode_length_buf = torch.tensor([3, 3, 9, 3])
    put(env, [0.1, 2.0, 0.2, 0.3], [0.0, 0.0, 0.0, 3.5])
    obs, reward, terminated, truncated, extras = env.step(torch.zeros(N, 1))
    done = torch.tensor([False, True, True, True])
    assert terminated.tolist() == [False, True, False, True]
    assert truncated.tolist() == [False, False, True, False]
    assert env.episode_length_buf.tolist() == [4, 0, 0, 0]
    assert extras["_final_obs"].tolist() == done.tolist()
    before = torch.where(done[:, None], extras["final_obs"]["policy"], obs["policy"])
    angle, rate, place, speed = before.unbind(-1)
    assert angle[1] > math.pi / 2
    assert place[3] > 3.0
    expected = torch.where(terminated, -2.0, 1.0) - angle**2 - 0.01 * speed.abs() - 0.005 * rate.abs()
    torch.testing.assert_close(reward, expected)
    new = obs["policy"][done]
    assert (new[:, 1:] == 0.0).all()
    assert (new[:, 0].abs() <= math.pi / 4).all()
    assert len(new[:, 0].unique()) == 3
    data = env.scene["robot"].data
    torch.testing.assert_close(data.joint_pos[done, 1], new[:, 0], rtol=0, atol=0)
    twin = make()
    twin.reset()
    twin.scene["robot"].data.joint_pos[:] = data.joint_pos
    twin.scene["robot"].data.joint_vel[:] = data.joint_vel
    twin.sim.forward()
    torch.testing.assert_close(data.body_state_w[done], twin.scene["robot"].data.body_state_w[done])


def test_final_observations_only_on_request():
    env = make(steps=1)
    env.reset()
    assert "final_obs" not in env.step(torch.zeros(N, 1))[4]


def test_ends_and_lengths_over_an_episode():
    env = make(steps=5)
    env.reset()
    truncations = []
    for _ in range(12):
        put(env, [0.01] * N)
        truncations.append(env.step(torch.zeros(N, 1))[3].tolist())
    assert [all(t) for t in truncations] == [False, False, False, False, True] * 2 + [False, False]
    assert env.common_step_counter == 12
    assert env.episode_length_buf.tolist() == [2] * N
    assert env.max_episode_length == 5


def test_assigned_episode_lengths_are_those_of_the_terms():
    """Trap 2."""
    env = make(steps=50)
    env.reset()
    put(env, [0.01] * N)
    buffer = env.episode_length_buf
    env.episode_length_buf = torch.tensor([49, 0, 49, 10], dtype=torch.int32)
    assert env.episode_length_buf is buffer
    _, _, _, truncated, _ = env.step(torch.zeros(N, 1))
    assert truncated.tolist() == [True, False, True, False]
    assert buffer.tolist() == [0, 1, 0, 11]


def test_what_was_handed_out_stays():
    """Traps 1 and 3."""
    env = make(compute_final_obs=True, steps=6)
    kept = []
    obs, extras = env.reset(seed=1)
    kept.append((obs["policy"], obs["policy"].clone()))
    logs, memory = [], []
    for k in range(15):
        obs, *values, extras = env.step(actions_of(k))
        handed = [obs["policy"], *values, extras["final_obs"]["policy"], *extras["log"].values()]
        kept += [(v, v.clone()) for v in handed]
        assert all(extras["log"] is not other for other in logs)
        logs.append(extras["log"])
        memory.append({v.untyped_storage().data_ptr() for v in handed})
        assert env.context.arrays["reward"].ptr not in memory[-1]
    for now, then in kept:
        assert torch.equal(now, then)
    assert not set.intersection(*memory)
    assert len(logs[0]) > 0
    assert all(isinstance(v, torch.Tensor) and v.ndim == 0 for v in logs[0].values())
    obs["policy"].fill_(math.nan)  # belongs to the caller
    assert torch.isfinite(env.step(torch.zeros(N, 1))[0]["policy"]).all()


# -- resets from outside


def per_env(state: dict[str, Any], num_envs: int) -> dict[str, torch.Tensor]:
    """Arrays of a state that have rows for environments."""
    found = {}
    for name, value in {**state["arrays"], **state["buffers"]}.items():
        if name.startswith("context.") and value.shape[0] != num_envs:
            continue
        if value.shape[0] % num_envs == 0:
            found[name] = value.unflatten(0, (num_envs, -1))
    return found


def test_masked_reset_leaves_the_others_alone():
    env, twin = ManagerBasedRLEnv(rich()), ManagerBasedRLEnv(rich())
    for e in (env, twin):
        e.reset(seed=5)
        rollout(e, 7)
    mask, others = torch.tensor([False, True, False, True]), [0, 2]
    before = per_env(env.get_state(), N)
    seen = env.obs_buf["policy"].clone()
    obs, _ = env.reset(options={"reset_mask": mask})
    after = per_env(env.get_state(), N)
    assert {"joint_q", "joint_qd", "context.rng", "context.rewards.sums", "qacc_warmstart"} <= before.keys()
    for name in before.keys() - {"context.moved", "context.reset", "context.nonfinite"}:
        assert torch.equal(before[name][others], after[name][others]), name
    assert torch.equal(obs["policy"][others], seen[others])
    assert not (obs["policy"][mask] == seen[mask]).any(dim=1).all()
    assert env.episode_length_buf.tolist() == [7, 0, 7, 0]
    for k in range(7, 27):
        one, two = env.step(actions_of(k)), twin.step(actions_of(k))
        assert torch.equal(one[0]["policy"][others], two[0]["policy"][others]), k
        assert torch.equal(one[1][others], two[1][others]), k


def test_reset_without_a_mask_is_of_all():
    env = make()
    env.reset(seed=1)
    rollout(env, 5)
    obs, extras = env.reset()
    assert env.episode_length_buf.tolist() == [0] * N
    assert (obs["policy"][:, 1:] == 0.0).all()
    assert isinstance(extras["log"], dict)
    assert env.common_step_counter == 5


def test_an_empty_mask_changes_nothing():
    env, twin = ManagerBasedRLEnv(rich()), ManagerBasedRLEnv(rich())
    for e in (env, twin):
        e.reset(seed=5)
        rollout(e, 5)
    env.reset(options={"reset_mask": torch.zeros(N, dtype=torch.bool)})
    assert_equal(rollout(env, 40, 5), rollout(twin, 40, 5))


# -- what is the same


def test_seeds_reproduce():
    one, two = ManagerBasedRLEnv(rich()), ManagerBasedRLEnv(rich())
    starts = [e.reset()[0]["policy"] for e in (one, two)]  # both of cfg.seed
    assert torch.equal(*starts)
    first = rollout(one, 45)
    assert_equal(first, rollout(two, 45))
    traces = []
    for seed in (7, 8):
        fresh = ManagerBasedRLEnv(rich())
        fresh.reset(seed=seed)
        traces.append(rollout(fresh, 45))
    again = ManagerBasedRLEnv(rich())
    again.reset(seed=7)
    assert_equal(rollout(again, 45), traces[0])
    assert not torch.equal(traces[0][0][0], traces[1][0][0])


def test_an_environment_does_not_depend_on_how_many_there_are():
    traces = []
    for num_envs in (4, 8):
        env = ManagerBasedRLEnv(rich(num_envs))
        env.reset(seed=9)
        traces.append(rollout(env, 100, count=4))
    assert_equal(*traces)


def test_state_goes_on_bit_for_bit():
    env = ManagerBasedRLEnv(rich())
    env.reset(seed=2)
    rollout(env, 45)
    state = env.get_state()
    expected = rollout(env, 100, 45)
    other = ManagerBasedRLEnv(rich())
    other.set_state(state)
    assert other.common_step_counter == 45
    assert_equal(rollout(other, 100, 45), expected)
    third = ManagerBasedRLEnv(rich())
    third.reset(seed=77)
    rollout(third, 10)
    torch.save(state, "state.pt")
    third.set_state(torch.load("state.pt", weights_only=True))
    assert_equal(rollout(third, 100, 45), expected)


def test_state_of_another_size_is_refused():
    with pytest.raises(ValueError, match="another task or size"):
        make(2).set_state(make(4).get_state())


def test_graphs_do_not_matter_on_the_cpu():
    traces = []
    for graph in (True, False):
        cfg = rich()
        cfg.sim.use_cuda_graph = graph
        env = ManagerBasedRLEnv(cfg)
        env.reset(seed=4)
        traces.append(rollout(env, 45))
        assert env.plan.graph_count == 0
        assert "graph launch" not in env.describe()
    assert_equal(*traces)


# -- configs


def test_all_problems_at_once():
    cfg = config()
    cfg.rewards.alive = RewardTermCfg(mdp.is_alive, {"speed": 1.0}, weight=1.0)
    cfg.terminations.time_out = TerminationTermCfg(mdp.is_alive)
    cfg.events.reset_pole = EventTermCfg(mdp.reset_joints_by_offset, {"position_range": (0.0, 1.0)}, mode="reset")
    cfg.metrics = {"speed": MetricTermCfg(mdp.joint_vel_l1, {"asset": 3})}
    with pytest.raises(ConfigError) as caught:
        ManagerBasedRLEnv(cfg)
    text = str(caught.value)
    for part in (
        "rewards.alive.params.speed: 'is_alive' has no such argument",
        "terminations.time_out.func: 'is_alive' returns float, a termination must be annotated '-> bool'",
        "events.reset_pole.params.velocity_range: is missing",
        "metrics.speed.params.asset",
    ):
        assert part in text, f"{part} is not in {text}"


def test_all_names_that_are_not_there_at_once():
    cfg = config()
    wheel = {"asset_cfg": SceneEntityCfg("robot", joint_names=["wheel"])}
    cfg.observations.policy.cart_pos = ObservationTermCfg(mdp.joint_pos, wheel)
    cfg.rewards.cart_vel = RewardTermCfg(mdp.joint_vel_l1, {"asset_cfg": SceneEntityCfg("robt")}, weight=1.0)
    cfg.actions.joint_effort = cfg.actions.joint_effort.replace(joint_names=["slider"])
    with pytest.raises(ConfigError) as caught:
        ManagerBasedRLEnv(cfg)
    text = str(caught.value)
    for part in (
        "observations.policy.cart_pos.params['asset_cfg']: joint of 'robot' expression 'wheel'",
        "slider_to_cart, cart_to_pole",
        "rewards.cart_vel.params['asset_cfg']: there is no asset or sensor 'robt'; did you mean robot?",
        "actions.joint_effort.joint_names",
    ):
        assert part in text, f"{part} is not in {text}"


def test_policy_group_is_needed():
    with pytest.raises(ConfigError, match="has no group 'policy'"):
        make(observations={"critic": ObservationsCfg().policy})


def test_switched_off_terms_are_not_there():
    rewards = RewardsCfg()
    rewards.cart_vel = None
    env = make(rewards=rewards, events=EventsCfg(), terminations=TerminationsCfg())
    assert env.reward_manager.active_terms == ["alive", "terminating", "pole_pos", "pole_vel"]


@pytest.mark.parametrize("name", ["targets", "masks", "rewards", "robot", "actions", "command"])
def test_commands_may_be_called_anything(name):
    cfg = rich()
    cfg.commands = {name: cfg.commands["place"]}
    env = ManagerBasedRLEnv(cfg)
    env.reset()
    assert torch.isfinite(env.step(torch.zeros(N, 1))[1]).all()


# -- the log


def test_log_of_terms_against_sums_by_hand():
    cfg = config(steps=12, scale_rewards_by_dt=True)
    cfg.metrics = {"speed": MetricTermCfg(mdp.joint_vel_l1, CART), "rate": MetricTermCfg(mdp.joint_vel_l1, POLE)}
    env = ManagerBasedRLEnv(cfg)
    env.reset(seed=0)
    env.episode_length_buf = torch.tensor([0, 3, 7, 7])
    names, data = env.reward_manager.active_terms, env.scene["robot"].data
    weights = torch.tensor([env.context.parameters[f"rewards.{n}.weight"] for n in names])
    sums, steps = torch.zeros(N, len(names)), torch.zeros(N)
    held: dict[str, float] = {}
    for k in range(30):
        if k == 4:
            data.joint_pos[0, 1] = 2.0
            env.sim.forward()
        out = env.step(actions_of(k))
        ended = out[2] | out[3]
        log = {key: float(value) for key, value in out[4]["log"].items()}
        torch.testing.assert_close(out[1], env.reward_manager.step_reward.sum(1) * DT)
        sums += env.reward_manager.step_reward * DT
        steps += 1
        if ended.any():
            held = {f"Episode_Reward/{n}": float(sums[ended, i].mean()) / (12 * DT) for i, n in enumerate(names)}
            means = (sums / DT / weights / steps[:, None])[ended].mean(0)  # the metrics are two rewards without weight
            held["Metrics/speed"] = float(means[names.index("cart_vel")])
            held["Metrics/rate"] = float(means[names.index("pole_vel")])
        for key, value in held.items():
            assert log[key] == pytest.approx(value, rel=1e-4, abs=1e-6), (k, key)
        assert log["Episode_Termination/time_out"] == int(out[3].sum())
        assert log["Episode_Termination/pole_fallen"] == int(out[2].sum())
        assert (env.reward_manager.episode_sums["alive"][ended] == 0.0).all()
        assert k != 4 or ended.tolist() == [True, False, True, True]
        sums[ended], steps[ended] = 0.0, 0.0
    assert held


# -- training


def test_rsl_rl_trains_it(tmp_path):
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        env = RslRlVecEnvWrapper(ManagerBasedRLEnv(rich(8)))
        runner = OnPolicyRunner(env, CartpoleManagerPPORunnerCfg(max_iterations=2, num_steps_per_env=8), tmp_path)
        before = [p.clone() for p in runner.alg.actor.parameters()]
        assert runner.learn()
    finally:
        torch.set_num_threads(threads)
    after = list(runner.alg.actor.parameters())
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert all(torch.isfinite(p).all() for p in after)
    assert env.unwrapped.common_step_counter == 16


def test_without_events_a_reset_brings_the_default_state():
    env = make(events=ManagerBasedRLEnvCfg().events)
    put(env, [0.4] * N, 0.3)
    env.reset(seed=0)
    data = env.scene["robot"].data
    assert torch.equal(data.joint_pos, data.default_joint_pos)
    assert not data.joint_vel.any()
    assert "reset_scene_to_default" in env.describe()
    env.close()
