# SPDX-License-Identifier: Apache-2.0
"""Recorded hooks of environments with a simulation, on a tape in the place of a CUDA graph."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.envs import hook_parts
from stripe_newton.envs.hook_graphs import EnvRows, HookGraphError, RecordedHook
from stripe_newton.rl.runner import OnPolicyRunner
from stripe_newton.rl.wrappers.rsl_rl import RslRlVecEnvWrapper
from stripe_tasks.cartpole import CartpoleEnvCfg
from stripe_tasks.cartpole.direct_warp import CartpoleWarpEnv
from tests.helpers.recorded_cart import (
    RecordedCart,
    RecordedCartCfg,
    WarpReset,
    first_difference,
    make,
    record_on_cpu,
    recorder_of,
    run,
    small_agent,
)


@pytest.fixture
def recording(monkeypatch):
    record_on_cpu(monkeypatch)


@pytest.fixture(scope="module")
def eager() -> list[dict[str, torch.Tensor]]:
    """Results of 150 steps without recordings, with resets of all or some environments."""
    found = run(make(), 150)
    counts = {int((x["terminated"] | x["truncated"]).sum()) for x in found}
    assert {0, 1, 6} <= counts, counts
    return found


def test_recorded_steps_are_those_of_the_hooks(eager, recording):
    env = make()
    assert first_difference(eager, run(env, 150)) == ""
    recorder = recorder_of(env)
    assert all(not h.reason for h in recorder.hooks), env.describe()
    assert all(recorder.joined(h) for h in recorder.hooks if h.joins)
    assert sum(recorder.hooks[4].has_graph(n) for n in range(1, 7)) >= 2  # numbers of environments that are reset
    text = env.describe()
    assert "graph, torch" in text
    how = f"eager: torch hook; graphs for {recorder.hooks[4].variants} frequent numbers of resets"
    assert env.plan.host_functions == [("reset", "_reset_idx, forward kinematics", how)]
    assert how in text


def test_states_are_saved_and_restored_in_place(recording):
    env = make()
    run(env, 20)
    torch.manual_seed(1)
    state, height = env.get_state(), env.sums["height"].clone()  # in a dict, and so no part of the state
    first = run(env, 20, 20)
    env.set_state(state)
    env.sums["height"][:] = height
    torch.manual_seed(1)
    assert first_difference(first, run(env, 20, 20)) == ""
    assert recorder_of(env)._attempts == 0  # nothing had to be recorded anew


class Careless(RecordedCart):
    """Reads a value, counts on the host and reads the counter of steps, each in a hook of its own."""

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        fallen, late = super()._get_dones()
        if late.any():
            self.sums["height"] += 1.0
        return fallen, late

    def _get_rewards(self) -> torch.Tensor:
        return super()._get_rewards() * (1.0 if self.common_step_counter < 25 else 2.0)

    def _reset_idx(self, env_ids: Any) -> None:
        super()._reset_idx(env_ids)
        self.extras["log"]["ends"] = torch.count_nonzero(self.reset_terminated[env_ids]).item()


def test_hooks_that_cannot_be_recorded_stay_eager(recording, monkeypatch):
    env = make(Careless)
    with monkeypatch.context() as patch:
        patch.setattr("stripe_newton.envs.hook_parts.records_on", lambda device: False)
        plain = make(Careless)
    torch.manual_seed(2)
    found = run(plain, 50)
    torch.manual_seed(2)
    assert first_difference(found, run(env, 50)) == ""
    reasons = {h.name.split(",")[0]: h.reason for h in recorder_of(env).hooks if h.reason}
    assert reasons.keys() == {"_get_dones", "_get_rewards", "_reset_idx"}
    text = env.describe()
    for part in (
        "envs/test_hook_graphs.py:{}: __bool__() reads the value",
        "envs/test_hook_graphs.py:{}: reads common_step_counter, a number that changes",
        "envs/test_hook_graphs.py:{}: item() reads the value",
    ):
        before, after = part.split("{}")
        assert before in text
        assert after in text
    assert text.count("graph, torch") == 3


def test_required_recordings_are_an_error(recording):
    env = make(Careless, hooks_graph=True)
    with pytest.raises(HookGraphError, match=r"_get_dones: envs/test_hook_graphs.py:\d+: __bool__"):
        run(env, 8)


def test_options(recording):
    assert make(hooks_graph=False)._recorder is None
    with pytest.raises(ConfigError, match="hooks_graph: is 'yes', must be 'auto', True or False"):
        RecordedCart(RecordedCartCfg(hooks_graph="yes"))


def test_the_rollout_takes_recorded_hooks_into_its_graph(recording):
    env = WarpReset(RecordedCartCfg(apply_action="step", episode_length_s=10.0))
    wrapped = RslRlVecEnvWrapper(env)
    wrapped.get_observations()
    before = env.get_state()
    runner = OnPolicyRunner(wrapped, small_agent(2))
    assert runner.no_graphs == {}
    after = env.get_state()
    assert after["step"] == before["step"]  # the rehearsal is undone
    for name, value in before["arrays"].items():
        assert torch.equal(value, after["arrays"][name]), name
    for name, value in before["buffers"].items():
        assert torch.equal(value, after["buffers"][name]), name
    runner.learn(2)
    assert runner._rollout._step.log_keys[-1] == "change"
    assert env.common_step_counter == before["step"] + 8


def test_hooks_and_kernels_share_two_graphs(eager, recording, monkeypatch):
    """All of a step up to the rewards, and the observations, with the resets of a third between them."""
    env = make()
    monkeypatch.setattr(env.plan, "captures", True)  # tapes hold the kernels of these stages, too
    assert first_difference(eager, run(env, 150)) == ""
    assert env.plan.graph_count == 2, env.describe()
    replays = [block.replay for block in env.plan._recorded]
    assert [replay is not None for replay in replays] == [True, False, True]


def test_graphs_of_warp_hooks_are_launched_in_every_step(recording, monkeypatch):
    cfg = CartpoleEnvCfg(decimation=2)  # of which torch actions would be watched
    cfg.sim.device, cfg.scene.num_envs = "cpu", 4
    env = CartpoleWarpEnv(cfg)
    assert recorder_of(env).hooks == []
    env.reset()
    launches = []
    run_plan = env.plan.run
    monkeypatch.setattr(env.plan, "run", lambda replay=True: (launches.append(replay), run_plan(replay)))
    for _ in range(5):
        env.step(torch.zeros(4, 1))
    assert launches == [True] * 5


class Patient(RecordedCart):
    """Reset whose rows do not depend on each other: new tensors, tensors in place, state of the simulation."""

    def __init__(self, cfg: RecordedCartCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        self.starts = torch.linspace(-0.2, 0.2, 2 * self.num_envs).reshape(self.num_envs, 2)
        self.resets = torch.zeros(self.num_envs, dtype=torch.int16)

    def _reset_idx(self, env_ids: Any) -> None:
        super(RecordedCart, self)._reset_idx(env_ids)
        self.resets[env_ids] += 1
        kept = torch.ones(self.num_envs)
        kept[env_ids] = 0.0
        self.actions = self.actions * kept[:, None]  # new memory
        start = self.starts[env_ids] + 0.01 * self.resets[env_ids].float()[:, None]
        self.robot.write_joint_state_to_sim(start, torch.zeros_like(start), env_ids=env_ids)

    def _get_observations(self) -> dict[str, torch.Tensor]:
        data = self.robot.data
        parts = (data.joint_pos, data.joint_vel, self.previous, self.actions, self.starts)
        return {"policy": torch.cat(parts, dim=-1)}


@pytest.fixture
def padding(recording, monkeypatch):
    monkeypatch.setattr("stripe_newton.envs.hook_parts.ResetPart.LEAST", 2)
    monkeypatch.setattr("stripe_newton.envs.hook_parts.ResetPart.STEP", 2)
    record, make_rows, recordings = hook_parts.Recorder.__call__, EnvRows.__init__, []

    def recorded(self, function):
        recordings.append(function)
        try:
            return record(self, function)
        finally:
            recordings.pop()

    def made(self, *args):
        assert not recordings, "a graph would copy from memory of the host that is gone by its first replay"
        make_rows(self, *args)

    monkeypatch.setattr(hook_parts.Recorder, "__call__", recorded)
    monkeypatch.setattr(EnvRows, "__init__", made)


def both(cls: type[RecordedCart], steps: int, monkeypatch) -> tuple[RecordedCart, str]:
    """A recorded environment of 12 carts after some steps, and where they differ from those without recordings."""
    scene = RecordedCartCfg().scene.replace(num_envs=12)
    with monkeypatch.context() as patch:
        patch.setattr("stripe_newton.envs.hook_parts.records_on", lambda device: False)
        plain = make(cls, scene=scene)
    env = make(cls, scene=scene)
    found = []
    for one in (plain, env):
        one.episode_length_buf = torch.arange(12) % 7  # so that other numbers end in each step
        torch.manual_seed(4)
        found.append(run(one, steps))
    counts = {int((x["terminated"] | x["truncated"]).sum()) for x in found[0]}
    assert {1, 2, 3} <= counts, counts
    return env, first_difference(*found)


def test_one_graph_resets_up_to_a_number(padding, monkeypatch):
    env, difference = both(Patient, 150, monkeypatch)
    assert difference == ""
    hook = recorder_of(env).hooks[4]
    assert (hook.why_not_padded, hook.recorded_variants) == ("", [2, 4])
    assert "graphs for up to 2, 4 resets" in env.describe()


def test_graphs_of_resets_hold_what_follows(padding, monkeypatch):
    """After the host knows the number of resets it launches one graph: resets and observations together."""
    own: list[str] = []
    build, replay = RecordedCart.__init__, RecordedHook.replay

    def capturing(self: RecordedCart, *args: Any, **kwargs: Any) -> None:
        build(self, *args, **kwargs)
        self.plan.captures = True  # tapes hold the kernels of all stages, too

    def noted(self: RecordedHook, variant: int = 0) -> None:
        own.append(self.name)
        replay(self, variant)

    monkeypatch.setattr(RecordedCart, "__init__", capturing)
    monkeypatch.setattr(RecordedHook, "replay", noted)
    env, difference = both(Patient, 150, monkeypatch)
    assert difference == ""
    _, resets, observations = env.plan._recorded
    assert set(resets.forms) == {2, 4}
    recorder, launched = recorder_of(env), []
    assert recorder.steps_to_check >= 60
    for name, block in {"alone": observations, **{str(k): graph for k, (_, graph) in resets.forms.items()}}.items():
        monkeypatch.setattr(block, "replay", lambda name=name, replay=block.replay: (launched.append(name), replay()))
    own.clear()
    ended = [int((x["terminated"] | x["truncated"]).sum()) for x in run(env, 50, 150)]
    assert launched == ["alone" if n in (0, *range(5, 13)) else "2" if n <= 2 else "4" for n in ended]
    assert {"4", "alone"} <= set(launched), str(ended)
    assert own == []
    text = "has been given up"
    recorder.hooks[4].give_up_padding(text)  # what was recorded with it holds no more
    launched.clear()
    run(env, 8, 200)
    assert set(launched) == {"alone"}


def test_the_first_number_is_one_with_a_graph(padding):
    env = make(Patient, scene=RecordedCartCfg().scene.replace(num_envs=12))
    env.episode_length_buf = torch.arange(12) // 2 % env.max_episode_length
    for _ in range(2):
        run(env, env.max_episode_length)
    hook = recorder_of(env).hooks[4]
    assert (hook.why_not_padded, hook.recorded_variants) == ("", [2])


class Counting(Patient):
    """Reset that adds up over the environments."""

    def _reset_idx(self, env_ids: Any) -> None:
        super()._reset_idx(env_ids)
        self.extras["log"]["height"] = self.sums["height"][env_ids].mean()
        self.sums["height"][env_ids] = 0.0


def test_a_reset_that_depends_on_their_number_has_a_graph_for_each(padding, monkeypatch):
    env, difference = both(Counting, 150, monkeypatch)
    assert difference == ""
    hook = recorder_of(env).hooks[4]
    assert not hook.reason
    assert "gives another 'log/height'" in hook.why_not_padded
    assert hook.variants >= 2
    assert f"graphs for {hook.variants} frequent numbers of resets; one for all up to a number" in env.describe()
