# SPDX-License-Identifier: Apache-2.0
"""Fused hooks on a GPU: operations and whole tasks give the bits of torch's own kernels."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.envs.call_counts import count_calls
from tests.helpers import fused_cases as cases
from tests.helpers.direct_tasks import DEVICE, TASKS, results, task_env
from tests.helpers.fused import run_fused
from tests.helpers.recorded_cart import first_difference

pytestmark = pytest.mark.gpu


@pytest.fixture
def on_gpu(monkeypatch):
    for name, value in list(vars(cases).items()):
        if isinstance(value, torch.Tensor):
            monkeypatch.setattr(cases, name, value.to(DEVICE))
    # Torch compiles scripts after some runs, to code that rounds otherwise than its kernels.
    compiles = torch._C._jit_texpr_fuser_enabled()
    torch._C._jit_set_texpr_fuser_enabled(False)
    with torch.device(DEVICE):
        yield
    torch._C._jit_set_texpr_fuser_enabled(compiles)


def test_operations_give_the_bits_of_torch(on_gpu):
    functions = cases.EXACT | cases.CLOSE
    fused = run_fused(functions, cases.N, device=DEVICE)
    differs = []
    for name, function in functions.items():
        leaves = cases.leaves(fused[name].result), cases.leaves(function())
        for index, (found, expected) in enumerate(zip(*leaves, strict=True)):
            if not torch.equal(found.nan_to_num(7.0), expected.nan_to_num(7.0)):
                differs.append(f"{name}[{index}]")
    alone = {
        name: [a for a in run.traced.alone if "arange" not in a and "empty" not in a] for name, run in fused.items()
    }
    assert not differs, " ".join(differs)
    assert {name: reasons for name, reasons in alone.items() if reasons} == {}


@pytest.mark.parametrize("columns", [1, 2, 3, 4, 5, 7, 8, 12, 13, 16, 21, 31, 32, 36, 48, 64])
def test_orders_of_sums_are_found(columns):
    """Sums, means and norms of a row: torch's order must be among those that are tried."""
    x = torch.randn(4096, columns, device=DEVICE)
    functions = {"sum": lambda: x.sum(-1), "mean": lambda: x.mean(-1), "norm": lambda: x.norm(dim=-1)}
    fused = run_fused(functions, 4096, device=DEVICE)
    assert [run.traced.alone for run in fused.values()] == [[], [], []]
    for name, function in functions.items():
        assert torch.equal(fused[name].result, function()), name


@pytest.mark.parametrize("name", TASKS)
def test_fused_steps_are_those_of_the_hooks(name):
    env = task_env(name, True)
    recorded = results(env, 300)
    assert first_difference(results(task_env(name, False), 300), recorded) == "", env.describe()
    statuses = {h.name: h.fusion.status for h in env._recorder.hooks}
    assert all("launch" in status for status in statuses.values()), statuses


def test_fewer_kernels_are_launched():
    counts = {}
    for fusion in (False, True):
        env = task_env("Stripe-Ant-Direct-v0", True, 4096, hooks_fusion=fusion)
        actions = torch.zeros(env.action_space.shape, device=DEVICE)
        for _ in range(160):
            env.step(actions)
        counts[fusion] = count_calls(lambda index, env=env, actions=actions: env.step(actions), 16)["kernels"]
    assert counts[True] < 0.3 * counts[False], counts
