# SPDX-License-Identifier: Apache-2.0
"""Metrics manager: against means taken with NumPy, over episodes of different lengths."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.fusion import HostFunction, KernelLaunches
from stripe_newton.managers import MetricsManager, MetricTermCfg
from tests.helpers.manager_world import manager_context, plan, set_reset

NUM_ENVS, STEPS = 3, 40


@wp.func
def first_joint_speed(env: int, robot: ArticulationData, factor: float) -> float:
    return factor * robot.joint_vel[env, 0]


@wp.func
def whether(env: int) -> bool:
    return True


class World:
    """Steps a metrics manager on joint velocities that the test chooses."""

    def __init__(self, terms: dict[str, Any]):
        self.context = context = manager_context(NUM_ENVS, "cartpole")
        context.owner = self
        self.manager = MetricsManager(terms, context)
        self.vel = context.entity("robot").data.joint_vel
        items = self.manager.compute_items(), self.manager.reset_items()
        self.eager = [item for part in items for item in part if isinstance(item, HostFunction)]
        self.plan = None if context.problems else plan(context, *items, [KernelLaunches("log", context.log.finish)])

    def step(self, values: np.ndarray, ended: np.ndarray) -> dict[str, float]:
        self.vel[:, 0] = torch.as_tensor(values, dtype=torch.float32)
        set_reset(self.context, torch.as_tensor(ended))
        self.plan.run()
        return dict(zip(self.context.log.keys, self.context.log.values.numpy().tolist(), strict=False))


def squared(env: World, power: int) -> torch.Tensor:
    return env.vel[:, 0] ** power


TERMS = {
    "speed": MetricTermCfg(func=first_joint_speed, params={"factor": 2.0}),
    "energy": MetricTermCfg(func=squared, params={"power": 2}),
}


def test_means_over_episodes_that_end_at_different_times():
    world, random = World(TERMS), np.random.default_rng(0)
    running: list[list[float]] = [[] for _ in range(NUM_ENVS)]
    expected = {"Metrics/speed": 0.0, "Metrics/energy": 0.0}
    seen = 0
    for _ in range(STEPS):
        values, ended = random.normal(size=NUM_ENVS).astype(np.float32), random.random(NUM_ENVS) < 0.2
        for env in range(NUM_ENVS):
            running[env].append(values[env])
        logged = world.step(values, ended)
        if ended.any():
            seen += 1
            done = np.flatnonzero(ended)
            expected["Metrics/speed"] = np.mean([2.0 * np.mean(running[e]) for e in done])
            expected["Metrics/energy"] = np.mean([np.mean(np.square(running[e])) for e in done])
            for env in done:
                running[env] = []
        assert logged.keys() == expected.keys()
        for key, value in expected.items():
            np.testing.assert_allclose(logged[key], value, rtol=2e-6, atol=1e-6)
    assert seen > 5


def test_the_length_of_the_episode_may_be_written_by_others():
    """A learner that spreads the first episodes over time sets their lengths; the mean is over the steps there were."""
    world = World({"speed": TERMS["speed"]})
    world.context.torch(world.context.episode.length)[:] = 500
    world.step(np.array([1.0, 2.0, 3.0]), np.zeros(NUM_ENVS, bool))
    logged = world.step(np.array([3.0, 4.0, 5.0]), np.array([True, False, True]))
    assert logged["Metrics/speed"] == pytest.approx(np.mean([4.0, 8.0]))


def test_a_parameter_changed_between_steps_takes_effect():
    world = World({"speed": TERMS["speed"]})
    none = np.zeros(NUM_ENVS, bool)
    world.step(np.ones(NUM_ENVS), none)
    world.context.parameters["metrics.speed.factor"] = 10.0
    assert world.step(np.ones(NUM_ENVS), ~none)["Metrics/speed"] == pytest.approx((2.0 + 10.0) / 2)


def test_sums_are_saved_and_restored():
    world, none = World({"speed": TERMS["speed"]}), np.zeros(NUM_ENVS, bool)
    world.step(np.ones(NUM_ENVS), none)
    kept = {name: world.context.torch(a).clone() for name, a in world.context.arrays.items() if "metrics" in name}
    first = world.step(np.full(NUM_ENVS, 3.0), ~none)
    world.step(np.full(NUM_ENVS, 50.0), none)
    for name, value in kept.items():
        world.context.torch(world.context.arrays[name]).copy_(value)
    assert first["Metrics/speed"] == pytest.approx(4.0)
    assert world.step(np.full(NUM_ENVS, 3.0), ~none) == first


def test_a_torch_term_is_eager_and_says_so():
    world = World(TERMS)
    assert [(item.terms, item.reason) for item in world.eager] == [(["energy"], "torch term 'energy'")]
    assert world.manager.active_terms == ["speed", "energy"]
    assert "speed" in str(world.manager)


@pytest.mark.parametrize("cfg", [None, {}, {"off": None}])
def test_without_terms_there_is_nothing_to_do(cfg):
    manager = MetricsManager(cfg, manager_context(NUM_ENVS, "cartpole"))
    assert manager.compute_items() == manager.reset_items() == manager.active_terms == []


@pytest.mark.parametrize(
    ("term", "said"),
    [
        (MetricTermCfg(func=whether), "metrics.bad"),
        (MetricTermCfg(func=first_joint_speed), "factor"),
        (MetricTermCfg(), "metrics.bad.func: is missing"),
        (3.0, "metrics.bad: is float, must be MetricTermCfg"),
    ],
)
def test_problems_are_gathered(term, said):
    world = World({"bad": term})
    assert len(world.context.problems) == 1
    assert said in world.context.problems[0]
