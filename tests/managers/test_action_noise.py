# SPDX-License-Identifier: Apache-2.0
"""Noise and delay of action terms."""

from __future__ import annotations

import numpy as np
import pytest

from stripe_newton.envs import mdp as cfgs
from stripe_newton.noise import ConstantNoiseCfg, GaussianNoiseCfg, NoiseCfg, UniformNoiseCfg
from tests.helpers import term_reference_random as reference
from tests.helpers.action_world import LEGS, N, World


def noise_reference(cfg: NoiseCfg, action: np.ndarray, stream: reference.Stream) -> np.ndarray:
    drawn = []
    for _ in range(action.shape[1]):
        if isinstance(cfg, ConstantNoiseCfg):
            drawn.append(np.full(len(action), cfg.bias))
        elif isinstance(cfg, UniformNoiseCfg):
            drawn.append(stream.uniform(cfg.n_min, cfg.n_max))
        else:
            drawn.append(cfg.mean + cfg.std * stream.normal())
    noise = np.stack(drawn, axis=1)
    return {"add": action + noise, "scale": action * noise, "abs": noise}[cfg.operation]


@pytest.mark.parametrize(
    "noise",
    [
        UniformNoiseCfg(n_min=-0.5, n_max=0.25),
        GaussianNoiseCfg(mean=1.0, std=0.1, operation="scale"),
        ConstantNoiseCfg(bias=0.5),
        UniformNoiseCfg(n_min=1.0, n_max=2.0, operation="abs"),
    ],
    ids=["add", "scale", "constant", "abs"],
)
def test_noise_is_on_what_is_done_not_on_what_was_asked(noise):
    legs = cfgs.JointEffortActionCfg(joint_names=LEGS, scale=3.0, noise=noise)
    world = World({"feet": cfgs.JointEffortActionCfg(joint_names=[".*foot"]), "legs": legs}, seed=5)
    stream = reference.Stream(5, N)
    action = np.random.default_rng(0).normal(size=(N, 8)).astype(np.float32)
    for _ in range(2):
        world.step(action)
        expected = 3.0 * noise_reference(noise, action[:, 4:], stream)
        np.testing.assert_allclose(world.processed("legs"), expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(world.manager.action.numpy(), action)
    np.testing.assert_array_equal(world.processed("feet"), action[:, :4])


def test_noise_is_a_parameter_that_may_change():
    world = World({"legs": cfgs.JointEffortActionCfg(joint_names=LEGS, noise=ConstantNoiseCfg(bias=0.5))})
    world.context.parameters["actions.legs.noise.bias"] = 2.0
    world.step(np.zeros((N, 4)))
    np.testing.assert_array_equal(world.processed("legs"), 2.0)


def test_noise_does_not_depend_on_the_number_of_environments():
    terms = {"legs": cfgs.JointEffortActionCfg(joint_names=LEGS, noise=GaussianNoiseCfg(), delay_max_lag=2)}
    few, many, again = (World(terms, n) for n in (3, 7, 3))
    for step in range(4):
        for world in (few, many, again):
            if step == 2:
                world.reset(0, 1)
            world.step(np.full((world.context.num_envs, 4), float(step)))
        np.testing.assert_array_equal(few.processed("legs"), many.processed("legs")[:3])
        np.testing.assert_array_equal(few.processed("legs"), again.processed("legs"))


def test_delayed_actions_are_those_of_the_lag_that_the_episode_drew():
    n, low, high = 24, 1, 3
    cfg = cfgs.JointEffortActionCfg(joint_names=LEGS, delay_min_lag=low, delay_max_lag=high)
    world = World({"feet": cfgs.JointEffortActionCfg(joint_names=[".*foot"]), "legs": cfg}, num_envs=n)
    draw = np.random.default_rng(0)
    world.reset(*range(n))
    history: list[list[np.ndarray]] = [[np.zeros(4)] * high for _ in range(n)]
    lags, seen = world.context.arrays["actions.legs.lag"], []
    for step in range(14):
        action = draw.normal(size=(n, 8)).astype(np.float32)
        world.step(action)
        lag = lags.numpy()
        seen += lag.tolist()
        for env in range(n):
            history[env].append(action[env, 4:])
            np.testing.assert_array_equal(world.processed("legs")[env], history[env][-1 - lag[env]])
        np.testing.assert_array_equal(world.processed("feet"), action[:, :4])
        np.testing.assert_array_equal(world.manager.action.numpy(), action)
        if step in (1, 6):
            ended = np.flatnonzero(draw.uniform(size=n) < 0.5).tolist()
            world.reset(*ended)
            still = np.setdiff1d(np.arange(n), ended)
            np.testing.assert_array_equal(lags.numpy()[still], lag[still])
            for env in ended:
                history[env] = [np.zeros(4)] * high
    assert sorted(set(seen)) == [1, 2, 3]
