# SPDX-License-Identifier: Apache-2.0
"""Fused hooks of environments: the same bits as eager hooks, a plain recording where they differ, launches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.cli.run_configs import load_configs
from stripe_newton.envs import hook_parts
from stripe_newton.envs.hook_graphs.fused import NotFusible, fusing_mode, operations
from stripe_newton.envs.hook_graphs.fused.elementwise import ELEMENTWISE, Elementwise
from stripe_newton.envs.hook_graphs.snapshot import Snapshot
from tests.helpers.fused import Fused, run_fused
from tests.helpers.recorded_cart import RecordedCart, first_difference, make, record_on_cpu, recorder_of, run

pytestmark = pytest.mark.slow  # each hook has a module of its own, which is compiled
STEPS, RESETS = 110, 16


class ArithmeticCart(RecordedCart):
    """Its rewards are of arithmetic alone, which rounds in the same way on all devices."""

    def _get_rewards(self) -> torch.Tensor:
        data = self.robot.data
        self.sums["height"] += data.joint_pos[:, 1] * data.joint_vel[:, 1]
        change = (self.actions - self.previous).square().sum(-1)
        self.extras["log"]["change"] = change.mean()
        return 1.0 - change - 0.1 * data.joint_vel[:, self.joints].abs().sum(-1)


@pytest.fixture(scope="module")
def eager() -> list[dict[str, torch.Tensor]]:
    return run(make(ArithmeticCart), STEPS)


@pytest.fixture
def fusing(monkeypatch):
    record_on_cpu(monkeypatch)
    monkeypatch.setattr(hook_parts, "fuses_on", lambda device: True)


def statuses(env: RecordedCart) -> dict[str, str]:
    return {h.name.split(",")[0]: h.fusion.status for h in recorder_of(env).hooks}


def test_fused_steps_are_those_of_the_hooks(eager, fusing):
    env = make(ArithmeticCart)
    assert first_difference(eager, run(env, STEPS)) == ""
    recorder = recorder_of(env)
    assert [h.reason or h.fusion.reason for h in recorder.hooks] == [""] * 6, env.describe()
    assert recorder.hooks[4].variants > 0
    assert statuses(env)["_get_dones"] == "7 operations in 1 launch"
    assert "graph, torch, 7 operations in 1 launch" in env.describe()


def test_a_hook_that_gives_other_numbers_is_recorded_as_it_is(eager, fusing, monkeypatch):
    wrong = Elementwise(("self",), lambda s, x: s.add(x, s.literal(1e-3, x.dtype)))
    monkeypatch.setitem(ELEMENTWISE, "abs", wrong)
    env = make(ArithmeticCart)
    assert first_difference(eager, run(env, STEPS)) == ""
    recorder = recorder_of(env)
    assert all(recorder.joined(h) for h in recorder.hooks if h.joins), env.describe()
    assert "graph, torch, not fused: envs/test_fused_hooks_slow.py" in env.describe()
    assert "gives another 'reward_buf' when it is replayed" in statuses(env)["_get_rewards"]
    assert statuses(env)["_pre_physics_step"].endswith("2 launches")


def test_an_error_in_fusing_is_named_and_costs_nothing_else(eager, fusing, monkeypatch):
    def fails(call: Any, rows: int) -> Any:
        raise ZeroDivisionError("a mistake")

    monkeypatch.setitem(operations.OPERATIONS, "clamp", fails)
    env = make(ArithmeticCart)
    assert first_difference(eager, run(env, STEPS)) == ""
    assert statuses(env)["_pre_physics_step"].endswith("a mistake")
    assert all(not h.reason for h in recorder_of(env).hooks)


def test_a_recording_that_fails_is_made_again_without_fusion(eager, fusing, monkeypatch):
    """Such as that of a hook which does something else then: the step is recorded, too."""
    record = hook_parts.Recorder.__call__

    def retried(self: hook_parts.Recorder, function: Callable[[], None]) -> Any:
        before = recorder_of(self.env).context.snapshot()  # a tape runs while it is recorded, a graph does not
        try:
            return record(self, function)
        except NotFusible:  # of one hook after the other
            before.restore()
            return retried(self, function)

    monkeypatch.setattr(hook_parts.Recorder, "__call__", retried)
    env = make(ArithmeticCart)
    monkeypatch.setattr(env.plan, "captures", True)
    assert first_difference(eager[:8], run(env, 8)) == ""
    monkeypatch.setattr(fusing_mode, "is_compiled", lambda code: False)
    recorder_of(env).hooks[0]._graphs.clear()
    env.plan.recapture()
    assert first_difference(eager[8:], run(env, STEPS - 8, 8)) == ""
    assert "its operations are others" in env.describe()
    assert all(recorder_of(env).joined(h) for h in recorder_of(env).hooks if h.joins)


def test_fusion_can_be_switched_off(eager, fusing):
    env = make(ArithmeticCart, hooks_fusion=False)
    assert first_difference(eager, run(env, STEPS)) == ""
    assert set(statuses(env).values()) == {""}


# -- tasks


class TaskHooks:
    """The torch hooks of a task, each to be run alone from the same state."""

    def __init__(self, name: str):
        cfg = load_configs(name, None).env
        cfg.sim.device, cfg.scene.num_envs, cfg.seed = "cpu", 64, 1
        env = gymnasium.make_vec(name, cfg=cfg).unwrapped
        env.reset(seed=1)
        actions = torch.rand(env.action_space.shape, generator=torch.Generator().manual_seed(2)) * 2.4 - 1.2
        for _ in range(4):
            env.step(actions)
        env._given = [actions.clone()]
        ids = torch.arange(3, 3 + RESETS)
        self.hooks: dict[str, Callable[[], None]] = {
            "actions": env._torch_pre_physics,
            "apply": env._apply_action,
            "dones": env._torch_dones,
            "rewards": env._torch_rewards,
            "reset": lambda: env._reset_idx(ids),
            "observations": env._torch_observations,
        }
        self.state = Snapshot(env, hook_parts.SKIPPED, hook_parts._arrays(env), "cpu")

    def results(self) -> dict[str, torch.Tensor]:
        found = self.state.results()
        return {name: self.state.typed(name, value) for name, value in found.items() if "random" not in name}


@pytest.mark.parametrize(
    ("name", "most"),
    [("Stripe-Ant-Direct-v0", 18), ("Stripe-Humanoid-Direct-v0", 18), ("Stripe-Cartpole-Direct-v0", 15)],
)
def test_hooks_of_tasks_are_a_few_kernels(name, most):
    """On a GPU the sums of a row are torch's bit for bit; here functions such as ``sin`` differ in the last digits."""
    task = TaskHooks(name)
    runs: dict[str, Fused] = run_fused(task.hooks, (64, RESETS), task.state.restore, task.results)
    operations_of = {hook: run.traced.operations for hook, run in runs.items()}
    launches = {hook: run.launched.launched for hook, run in runs.items()}
    assert sum(launches.values()) <= most, launches
    assert sum(operations_of.values()) > 3 * sum(launches.values())
    for hook, function in task.hooks.items():
        task.state.restore()
        with torch.no_grad():
            function()
        for key, value in task.results().items():
            found = runs[hook].left[key]
            torch.testing.assert_close(found, value, rtol=1e-5, atol=1e-5, equal_nan=True, msg=f"{hook}: {key}")
    task.state.restore()
