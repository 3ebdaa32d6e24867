# SPDX-License-Identifier: Apache-2.0
"""Step graph on a GPU: one graph, few other calls, no host synchronisation; replays equal single kernels."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import gymnasium
import pytest
import torch
import warp as wp

import stripe_tasks  # noqa: F401
from stripe_newton.configclass import resolve_name
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.envs.call_counts import count_calls, warp_calls
from stripe_newton.fusion import GraphCaptureError
from stripe_newton.managers import MetricTermCfg
from stripe_newton.sim import MuJoCoSolverCfg
from stripe_tasks.cartpole import CartpoleEnvCfg
from stripe_tasks.cartpole.direct_warp import CartpoleWarpEnv
from stripe_tasks.locomotion.manager_based import AntManagerEnvCfg

pytestmark = pytest.mark.gpu

DEVICE = "cuda:0"
N = 64
TASK = "Stripe-Cartpole-v0"
FORMS = [TASK, "Stripe-Cartpole-Direct-Warp-v0", "Stripe-Cartpole-Direct-v0"]
BOUND = 100
"""Steps after which the host has heard of what happened on the device."""


def config(task: str = TASK, **changes: Any) -> Any:
    cfg = resolve_name(gymnasium.spec(task).kwargs["env_cfg_entry_point"])().replace(**changes)
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = DEVICE, N, 3
    return cfg


def make(task: str = TASK, graph: bool = True, **changes: Any) -> Any:
    cfg = config(task, **changes)
    cfg.sim.use_cuda_graph = graph
    return gymnasium.make_vec(task, cfg=cfg).unwrapped


def actions_for(steps: int, seed: int = 0, size: int = 1) -> torch.Tensor:
    generator = torch.Generator(device=DEVICE).manual_seed(seed)
    return 2.0 * torch.rand(steps, N, size, generator=generator, device=DEVICE) - 1.0


@contextlib.contextmanager
def nobody_waits() -> Iterator[None]:
    """Within it a wait of the host for the device is an error."""
    mode = torch.cuda.get_sync_debug_mode()
    torch.cuda.set_sync_debug_mode("error")
    try:
        with warp_calls() as counts:
            yield
        assert counts["host_syncs"] == 0
    finally:
        torch.cuda.set_sync_debug_mode(mode)


# -- the calls of a step


def count_in_steady_state(env: Any, steps: int = 40) -> dict[str, float]:
    env.reset()
    actions = actions_for(steps + 5)
    for k in range(5):
        env.step(actions[k])
    return count_calls(lambda k: env.step(actions[5 + k]), steps)


@pytest.mark.parametrize("task", FORMS[:2])
def test_a_step_is_one_graph_launch(task):
    env = make(task)
    counts = count_in_steady_state(env)
    assert counts["graph_launches"] == 1.0
    assert counts["kernel_launches"] + counts["copies"] <= 3.0, counts
    assert counts["host_syncs"] == 0.0
    assert counts["kernels"] > 5.0
    assert env.plan.graph_count == 1
    assert "1 graph launch a step" in env.describe()


def test_without_graphs_a_step_is_many_launches():
    """Counts of the same step kernel by kernel: they show that the counter of the test above counts."""
    counts = count_in_steady_state(make(graph=False), 10)
    assert counts["graph_launches"] == 0.0
    assert counts["kernel_launches"] >= 5.0


@pytest.mark.parametrize("task", FORMS[:2])
def test_nobody_waits_in_a_step(task):
    """Not where episodes end either, nor with final observations, a change of a parameter apart."""
    env = make(task, episode_length_s=0.5, **({"compute_final_obs": True} if task == TASK else {}))
    env.reset()
    actions = actions_for(80)
    for k in range(5):
        env.step(actions[k])
    ends = torch.zeros((), device=DEVICE)
    with nobody_waits():
        for action in actions[5:]:
            _, _, terminated, truncated, extras = env.step(action)
            ends += (terminated | truncated).sum()
            assert len(extras["log"]) > 0 or task != TASK
    assert float(ends) >= 2 * N


def own_pole(env: Any) -> torch.Tensor:
    return env.scene["robot"].data.joint_pos[:, 1]


def test_a_torch_term_splits_the_graph():
    env = ManagerBasedRLEnv(config(metrics={"pole": MetricTermCfg(own_pole)}))
    counts = count_in_steady_state(env, 10)
    assert counts["graph_launches"] == env.plan.graph_count == 2
    assert counts["host_syncs"] == 0.0
    assert "torch term 'pole'" in env.describe()


# -- replayed and eager


def step_all(env: Any, actions: torch.Tensor) -> dict[str, torch.Tensor]:
    kept: dict[str, list[torch.Tensor]] = {}
    for action in actions:
        obs, reward, terminated, truncated, extras = env.step(action)
        values = {"obs": obs["policy"], "reward": reward, "terminated": terminated, "truncated": truncated}
        values |= {k: v for k, v in extras["log"].items() if k.startswith("Episode_Termination/")}
        values["rng"] = wp.to_torch(env.context.rng).clone()
        values["length"] = env.episode_length_buf.clone()
        for key, value in values.items():
            kept.setdefault(key, []).append(value)
    return {key: torch.stack(values) for key, values in kept.items()}


def assert_equal(one: dict[str, torch.Tensor], two: dict[str, torch.Tensor]) -> None:
    assert one.keys() == two.keys()
    for key, value in one.items():
        differs = (value != two[key]).reshape(len(value), -1).any(dim=1).nonzero().flatten().tolist()
        assert not differs, f"{key} differs in {len(differs)} steps, first in step {differs[0]}"


@pytest.mark.parametrize("task", FORMS[:2])
def test_replayed_equals_eager(task):
    """1000 steps with resets, time-outs and random draws, bit for bit."""
    actions, results = actions_for(1000), []
    for graph in (True, False):
        env = make(task, graph=graph)
        env.reset(seed=11)
        results.append(step_all(env, actions))
        env.close()
    assert_equal(*results)
    assert int(results[0]["terminated"].sum()) > N
    starts = results[0]["obs"][results[0]["terminated"] | results[0]["truncated"]][:, 0]
    assert len(starts.unique()) > 0.9 * len(starts)


def test_time_outs_are_replayed_too():
    actions, results = 0.02 * actions_for(100), []
    for graph in (True, False):
        env = make(graph=graph, episode_length_s=0.4)
        env.reset(seed=1)
        results.append(step_all(env, actions))
    assert_equal(*results)
    assert int(results[0]["truncated"].sum()) > 2 * N


def test_masked_reset_between_replays_leaves_the_others_alone():
    env, twin = make(), make()
    actions, mask = 0.1 * actions_for(30), torch.arange(N, device=DEVICE) % 3 == 0
    for e in (env, twin):
        e.reset(seed=5)
        step_all(e, actions[:10])
    env.reset(options={"reset_mask": mask})
    assert env.episode_length_buf[mask].tolist() == [0] * int(mask.sum())
    one, two = step_all(env, actions[10:]), step_all(twin, actions[10:])
    for key in ("obs", "reward", "terminated", "truncated", "rng"):
        mine, other = (x[key].view(torch.int32) if key == "rng" else x[key] for x in (one, two))
        assert torch.equal(mine[:, ~mask], other[:, ~mask]), key


def test_state_goes_on_where_it_stopped():
    env, other = make(), make()
    actions = actions_for(100)
    env.reset(seed=2)
    step_all(env, actions[:20])
    state = env.get_state()
    expected = step_all(env, actions[20:])
    other.reset(seed=9)
    step_all(other, actions[:5])
    other.set_state(state)
    assert_equal(step_all(other, actions[20:]), expected)


def test_parameters_hold_for_the_next_replay():
    env = make()
    env.reset(seed=0)
    actions = 0.01 * actions_for(10)
    step_all(env, actions[:4])
    state = env.get_state()
    before = env.step(actions[4])[1]
    env.set_state(state)
    env.context.parameters["rewards.alive.weight"] = 101.0
    after, terminated = env.step(actions[4])[1:3]
    torch.testing.assert_close(after - before, torch.where(terminated, 0.0, 100.0), rtol=0, atol=1e-4)
    assert env.plan.graph_count == 1


# -- what cannot be


class ReadsBack(CartpoleWarpEnv):
    def _launch_rewards(self) -> None:
        super()._launch_rewards()
        self.warp.reward.numpy()


def test_a_hook_that_waits_for_the_device_is_named():
    cfg = CartpoleEnvCfg()
    cfg.sim.device, cfg.scene.num_envs = DEVICE, N
    env = ReadsBack(cfg)
    env.reset()
    with pytest.raises(GraphCaptureError, match=r"stage 'outcome': _launch_rewards cannot be captured \(.+\)"):
        env.step(torch.zeros(N, 1, device=DEVICE))
    other = make()  # the device is as good as before
    other.reset()
    for action in actions_for(5):
        assert torch.isfinite(other.step(action)[1]).all()
    cfg.sim.use_cuda_graph = False
    eager = ReadsBack(cfg)
    eager.reset()
    eager.step(torch.zeros(N, 1, device=DEVICE))


def falling_ant() -> ManagerBasedRLEnv:
    """Legs that touch the ground, after a fall, where there is room for one contact or pair that may be one."""
    cfg = AntManagerEnvCfg()
    cfg.scene.robot.init_state.pos = (0.0, 0.0, 1.0)
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = DEVICE, N, 0
    cfg.sim.solver = MuJoCoSolverCfg(nconmax=1, njmax=200, fused_limbs=False)
    env = ManagerBasedRLEnv(cfg)
    env.reset(seed=0)
    return env


def error_of(env: Any, actions: torch.Tensor, error: type[Exception], wait: bool = False) -> tuple[int, str]:
    """In which step an error comes, and what it says."""
    found = None
    for index, action in enumerate(actions):
        try:
            env.step(action)
        except error as raised:
            found = index, str(raised)
            break
        if wait:
            torch.cuda.synchronize()
    assert found is not None, f"no error in {len(actions)} steps"
    return found


def test_overflow_is_an_error_soon_after_it_happened():
    env = falling_ant()
    zeros = torch.zeros(120 + BOUND, *env.action_space.shape, device=DEVICE)
    happened, text = error_of(env, zeros[:120], RuntimeError, wait=True)  # the step after it
    assert "dropped" in text
    assert "set MuJoCoSolverCfg(nconmax=" in text
    assert happened > 2
    env = falling_ant()
    for action in zeros[:2]:
        env.step(action)
    with nobody_waits():
        heard, text = error_of(env, zeros[2 : happened + BOUND], RuntimeError)
    assert heard + 2 >= happened
    assert "nconmax is" in text


@pytest.mark.parametrize("task", FORMS)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_actions_that_are_not_finite_are_an_error_a_few_steps_later(task, value):
    env = make(task)
    env.reset()
    actions = 0.1 * actions_for(BOUND)
    for action in actions[:5]:
        env.step(action)
    actions[5, ::2] = value
    index, text = error_of(env, actions[5:], ValueError)
    assert "not finite" in text
    assert index < BOUND - 5
    env.reset()
    torch.cuda.synchronize()
    for action in actions[:5]:  # told once
        assert torch.isfinite(env.step(action)[0]["policy"]).all()


@pytest.mark.parametrize("task", FORMS[:2])
def test_no_wait_for_actions_that_are_not_finite(task):
    env = make(task)
    env.reset()
    actions = 0.1 * actions_for(BOUND)
    for action in actions[:5]:
        env.step(action)
    actions[5] = math.nan
    with nobody_waits():
        _, text = error_of(env, actions[5:], ValueError)
    assert "not finite" in text


@pytest.mark.parametrize("task", FORMS)
def test_actions_are_clamped_on_request(task):
    env, twin = make(task, nonfinite_actions="clamp"), make(task)
    for e in (env, twin):
        e.reset(seed=1)
    bad, good = torch.zeros(N, 1, device=DEVICE), torch.zeros(N, 1, device=DEVICE)
    bad[:8], bad[8:16], good[8:16] = math.nan, math.inf, 1.0e6
    one, two = env.step(bad), twin.step(good)
    torch.cuda.synchronize()
    assert torch.equal(one[2], two[2])
    assert torch.equal(one[1], two[1])
    running = ~(one[2] | one[3])
    assert torch.equal(one[0]["policy"][running], two[0]["policy"][running])
    env.step(good)
    torch.cuda.synchronize()
    env.step(good)


@pytest.mark.parametrize("task", FORMS)
def test_a_world_that_is_not_finite_begins_anew_alone(task):
    env, twin = make(task), make(task)
    actions = 0.05 * actions_for(40)
    for e in (env, twin):
        e.reset(seed=4)
        data = e.scene["robot"].data
        data.joint_pos[:] = 0.0
        data.joint_vel[:] = 0.0
        e.sim.forward()
        for action in actions[:5]:
            e.step(action)
    env.scene["robot"].data.joint_vel[7] = math.nan
    others = torch.arange(N, device=DEVICE) != 7
    for k, action in enumerate(actions[5:20]):
        one, two = env.step(action), twin.step(action)
        assert torch.isfinite(one[0]["policy"]).all()
        assert torch.isfinite(one[1]).all()
        assert bool(one[2][7]) == (k == 0)
        assert torch.equal(one[0]["policy"][others], two[0]["policy"][others])
        assert torch.equal(one[1][others], two[1][others])
    torch.cuda.synchronize()
    assert env.nonfinite_worlds == 1
    assert twin.nonfinite_worlds == 0
