# SPDX-License-Identifier: Apache-2.0
"""Torch terms that cannot be called, or return something else than a number for each environment: an error with their
path."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.envs import mdp
from stripe_newton.fusion import HostFunction
from stripe_newton.managers import (
    EventManager,
    EventTermCfg,
    MetricsManager,
    MetricTermCfg,
    RewardManager,
    RewardTermCfg,
    TerminationManager,
    TerminationTermCfg,
)
from tests.helpers.manager_world import manager_context

NUM_ENVS = 3
MANAGERS = {
    "rewards": lambda func, context: RewardManager({"own": RewardTermCfg(func=func, weight=1.0)}, context),
    "terminations": lambda func, context: TerminationManager({"own": TerminationTermCfg(func=func)}, context),
    "metrics": lambda func, context: MetricsManager({"own": MetricTermCfg(func=func)}, context),
}


def term_item(kind: str, func: object) -> tuple[list[str], list[HostFunction]]:
    """Make a manager with one term; returns the problems of the config, and the items that call the term."""
    context = manager_context(NUM_ENVS, "cartpole", num_terminations=1)
    context.owner = object()
    items = MANAGERS[kind](func, context).compute_items()
    return context.problems, [item for item in items if isinstance(item, HostFunction)]


WRONG = [
    (torch.zeros(7), r"torch.float32 of shape \(7,\)"),
    (torch.zeros(NUM_ENVS, 1), rf"torch.float32 of shape \({NUM_ENVS}, 1\)"),
    (torch.tensor(1.0), r"torch.float32 of shape \(\), must .* as by torch.sum\(..., dim=1\)"),
    (torch.zeros(NUM_ENVS, dtype=torch.complex64), "torch.complex64"),
    (torch.zeros(NUM_ENVS, device="meta"), "torch.float32 of shape .* on 'meta', without values"),
    (None, "None"),
    ("text", "'text'"),
    (np.zeros(NUM_ENVS), "array"),
]
RIGHT = [torch.ones(NUM_ENVS), torch.ones(NUM_ENVS, dtype=torch.int64), 1.0, True]


@pytest.mark.parametrize("kind", MANAGERS)
def test_results_of_another_kind_are_refused(kind):
    given: list[object] = []

    def own(env):
        return given[-1]

    problems, (item,) = term_item(kind, own)
    assert problems == []
    for value, said in WRONG:
        given.append(value)
        with pytest.raises(ValueError, match=rf"^{kind}.own: 'own' returned {said}") as caught:
            item.function()
        assert f"must return one number for each environment, shape ({NUM_ENVS},)" in str(caught.value)
    for value in RIGHT:
        given.append(value)
        item.function()


def test_functions_that_cannot_be_called():
    def without():
        """Takes no environment."""

    def further(env, limit):
        """Takes a parameter that is not given."""

    @wp.kernel
    def kernel(values: wp.array[float]):
        values[0] = 1.0

    assert term_item("rewards", without)[0] == [
        "rewards.own.func: 'without()' is called with the environment: too many positional arguments"
    ]
    assert term_item("metrics", further)[0] == [
        "metrics.own.func: 'further(env, limit)' is called with the environment: missing a required argument: 'limit'"
    ]
    (problem,) = term_item("terminations", kernel)[0]
    assert problem.startswith("terminations.own.func: is the kernel")
    assert "write @wp.func" in problem


def test_functions_of_events_take_the_environments_too():
    def own(env):
        """Takes no indices."""

    context = manager_context(NUM_ENVS, "cartpole")
    EventManager({"own": EventTermCfg(func=own, mode="reset")}, context).reset_items()
    assert context.problems == [
        "events.own.func: 'own(env)' is called with the environment, env_ids: too many positional arguments"
    ]


def test_a_changed_term_is_checked_too():
    context = manager_context(NUM_ENVS, "cartpole")
    manager = MetricsManager({"own": MetricTermCfg(func=lambda env: 1.0)}, context)
    manager.compute_items()
    with pytest.raises(ValueError, match=r"metrics.own.func: '<lambda>\(\)' is called with the environment: too many"):
        manager.set_term_cfg("own", MetricTermCfg(func=lambda: 1.0))


def test_an_event_returns_nothing():
    context = manager_context(NUM_ENVS, "cartpole")
    EventManager({"own": EventTermCfg(func=mdp.is_alive, mode="reset")}, context).reset_items()
    assert context.problems == [
        "events.own.func: 'is_alive' returns a value, which is no event: an event returns nothing"
    ]
    due = manager_context(NUM_ENVS, "cartpole")
    (event,) = EventManager({"own": EventTermCfg(func=lambda env, ids: ids, mode="startup")}, due).startup_items()
    assert isinstance(event, HostFunction)
    with pytest.raises(ValueError, match=r"^events\.own\.func: returned a tensor; an event returns nothing"):
        event.function()


def test_a_parameter_is_nan_only_where_the_default_is():
    @wp.func
    def own(env: int, scale: float) -> float:
        return scale

    context = manager_context(NUM_ENVS, "cartpole")
    RewardManager({"own": RewardTermCfg(func=own, weight=1.0, params={"scale": math.nan})}, context).compute_items()
    assert context.problems == ["rewards.own.params.scale: is nan, must not be NaN"]
