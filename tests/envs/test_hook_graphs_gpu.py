# SPDX-License-Identifier: Apache-2.0
"""Recorded torch hooks on a GPU: the same bits as eager ones, two graphs and one wait a step, reasons with lines."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from stripe_newton.envs.call_counts import count_calls
from stripe_newton.envs.hook_graphs import HookRecorder
from stripe_newton.rl.runner import OnPolicyRunner
from stripe_newton.rl.wrappers.rsl_rl import RslRlVecEnvWrapper
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from tests.helpers.direct_tasks import DEVICE, TASKS, results, task_env
from tests.helpers.recorded_cart import (
    RecordedCart,
    WarpReset,
    first_difference,
    make,
    recorder_of,
    run,
    small_agent,
)

pytestmark = pytest.mark.gpu


def cart(cls: type[RecordedCart] = RecordedCart, **changes: Any) -> RecordedCart:
    return make(
        cls, sim=SimulationCfg(device=DEVICE, dt=0.01, solver=MuJoCoSolverCfg(disable_contacts=True)), **changes
    )


def test_state_in_all_forms_carries_over():
    eager = run(cart(hooks_graph=False), 200)
    env = cart()  # one after the other, as each begins with its seed and all draw from torch's generator
    assert first_difference(eager, run(env, 200)) == ""
    assert not [h.reason for h in recorder_of(env).hooks if h.reason], env.describe()


class OwnGenerator(RecordedCart):
    """Draws its noise from a generator of its own, which lives on the device."""

    def _get_observations(self) -> dict[str, torch.Tensor]:
        if not hasattr(self, "generator"):
            self.generator = torch.Generator(self.device).manual_seed(11)
        seen = super()._get_observations()["policy"]
        return {"policy": seen + torch.rand(seen.shape, generator=self.generator, device=self.device)}


def test_generators_of_a_task_advance_in_replays():
    eager = run(cart(OwnGenerator, hooks_graph=False), 200)
    env = cart(OwnGenerator)
    assert first_difference(eager, run(env, 200)) == ""
    assert not [h.reason for h in recorder_of(env).hooks if h.reason], env.describe()


def test_hooks_go_on_when_all_are_recorded_anew():
    """A pool of memory ends with its last graph; the next recordings need another one."""
    env = cart()
    run(env, 30)
    recorder = recorder_of(env)
    for _ in range(2):
        recorder.start_again("a test")
        run(env, 30)
        assert not [h.reason for h in recorder.hooks if h.reason], env.describe()
        assert recorder.is_settled


@pytest.mark.parametrize("name", TASKS)
def test_recorded_steps_are_those_of_the_hooks(name):
    env = task_env(name, True)
    recorded = results(env, 300)
    assert first_difference(results(task_env(name, False), 300), recorded) == "", env.describe()
    assert sum(int((x["terminated"] | x["truncated"]).sum()) for x in recorded) > 100


@pytest.mark.parametrize("name", TASKS)
def test_a_step_waits_once(name, monkeypatch):
    env = task_env(name, True, apply_action="step")
    actions = torch.zeros(env.action_space.shape, device=DEVICE)
    for _ in range(140):
        env.step(actions)
    while env._recorder.steps_to_check < 32:  # the host waits more often where hooks are compared
        env.step(actions)
    monkeypatch.setattr(HookRecorder, "OFTEN", 10**9)  # nothing is recorded while the calls are counted
    counts = count_calls(lambda k: env.step(actions), 32)
    assert counts["host_syncs"] <= 1.0, counts
    assert counts["graph_launches"] <= 3.1, counts
    assert env.plan.graph_count == 2, env.describe()


class Careless(RecordedCart):
    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        fallen, late = super()._get_dones()
        if late.any():
            self.sums["height"] += 1.0
        return fallen, late

    def _reset_idx(self, env_ids: Any) -> None:
        super()._reset_idx(env_ids)
        self.sums["height"][self.reset_terminated] = self.sums["height"][self.reset_terminated].clone()


def test_hooks_that_wait_stay_eager_with_their_lines():
    eager = run(cart(Careless, hooks_graph=False), 100)
    env = cart(Careless)
    assert first_difference(eager, run(env, 100)) == ""
    reasons = {h.name.split(",")[0]: h.reason for h in recorder_of(env).hooks if h.reason}
    assert reasons.keys() == {"_get_dones", "_reset_idx"}, reasons
    assert all(r.startswith("envs/test_hook_graphs_gpu.py:") for r in reasons.values()), reasons
    assert torch.isfinite(torch.rand(4, device=DEVICE)).all()  # the device is as good as before


def test_the_rollout_of_the_runner_takes_them_into_its_graph():
    env = cart(WarpReset, apply_action="step", episode_length_s=10.0)
    runner = OnPolicyRunner(RslRlVecEnvWrapper(env), small_agent(4))
    assert runner.no_graphs == {}, env.describe()
    runner.learn(4)
    assert runner._rollout is not None
    assert runner._rollout.recorded
    assert runner._rollout._step.log_keys[-1] == "change"
