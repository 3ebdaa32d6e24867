# SPDX-License-Identifier: Apache-2.0
"""Observation normalisation: running statistics against those of all samples together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from stripe_kernels import processing
from stripe_newton.envs import mdp
from stripe_newton.managers import ObservationTermCfg as Term
from stripe_newton.managers import RunningNormCfg, SceneEntityCfg
from tests.helpers.manager_world import ObservationWorld
from tests.helpers.manager_world import observation_group as group

N = 4
J = 8  # joints of the ant: legs and feet in turn
LEGS = [0, 2, 4, 6]
ALL_LEGS = {"asset_cfg": SceneEntityCfg("robot", joint_names=[".*_leg"])}
SLIDER = {"asset_cfg": SceneEntityCfg("robot", joint_ids=[0])}
COUNT = 70  # more than there are slices, and not a multiple
NORMALISED = {
    "legs": Term(mdp.joint_pos, ALL_LEGS, scale=2.0),
    "past": Term(mdp.joint_pos, SLIDER, history_length=2),
}


def normalised_world(**fields: Any) -> ObservationWorld:
    groups = {"policy": group(NORMALISED, normalization=RunningNormCfg(**fields)), "plain": group(NORMALISED)}
    return ObservationWorld(groups, COUNT)


def joint_signal(step: int) -> np.ndarray:
    draw = np.random.default_rng(step)
    return (draw.normal(size=(COUNT, J)) * np.linspace(0.1, 3.0, J) + np.linspace(-5.0, 5.0, J)).astype(np.float32)


def normalised(samples: list[np.ndarray], values: np.ndarray, eps: float, clip: float) -> np.ndarray:
    seen = np.concatenate(samples).astype(float)
    return np.clip((values - seen.mean(axis=0)) / (seen.std(axis=0) + eps), -clip, clip)


def test_running_normalisation_is_by_all_that_was_seen():
    one, two = (normalised_world(eps=0.05, clip=2.0) for _ in range(2))
    update, samples = "observations.policy.normalization.update", list[np.ndarray]()
    clipped = 0
    for step in range(14):
        for world in (one, two):
            if step == 5:
                world.reset(0, 7)  # statistics outlive an episode
            world.context.parameters[update] = not 8 <= step < 12
            world.step(joint_signal(step))
        raw = one["plain"]
        np.testing.assert_array_equal(raw[:, :4], 2.0 * joint_signal(step)[:, LEGS])
        before = joint_signal(step - 1 if step else 0)[:, 0]
        if step == 5:
            before[[0, 7]] = joint_signal(step)[[0, 7], 0]
        np.testing.assert_array_equal(raw[:, 4:], np.stack([before, joint_signal(step)[:, 0]], axis=1))
        if not 8 <= step < 12:
            samples.append(raw)
        expected = normalised(samples, raw, 0.05, 2.0)
        np.testing.assert_allclose(one["policy"], expected, rtol=1e-4, atol=1e-5, err_msg=str(step))
        clipped += int((np.abs(expected) == 2.0).sum())
        states = one.state(), two.state()
        for name in states[0]:  # bit for bit
            np.testing.assert_array_equal(*(s[name] for s in states), err_msg=name)
    assert clipped > 100
    seen = np.concatenate(samples).astype(float)
    arrays = one.context.arrays
    for name, value in (("mean", seen.mean(axis=0)), ("var", seen.var(axis=0)), ("seen", np.full(6, len(seen)))):
        found = arrays[f"observations.policy.normalization.{name}"].numpy()
        np.testing.assert_allclose(found, value, rtol=1e-4, atol=1e-6)


def test_normalisation_that_never_saw_anything_leaves_values_as_they_are():
    world = normalised_world(eps=0.0, update=False)
    world.step(joint_signal(0))
    np.testing.assert_array_equal(world["policy"], np.clip(world["plain"], -10.0, 10.0))


def test_the_last_observation_of_an_episode_is_no_sample_of_its_own():
    world = ObservationWorld({"policy": group(NORMALISED, normalization=RunningNormCfg())}, N, where_reset=True)
    x = joint_signal(0)[:N]
    world.step(x)
    before = world.state()
    world.context.torch(world.robot.joint_pos)[:] += 0.5
    world.observe_ended(2)
    legs = 2.0 * x[:, LEGS].astype(float)
    shifted = (legs[2] + 1.0 - legs.mean(axis=0)) / (legs.std(axis=0) + 0.01)
    np.testing.assert_allclose(world["policy"][2, :4], np.clip(shifted, -10.0, 10.0), rtol=1e-4)
    np.testing.assert_array_equal(world["policy"][[0, 1, 3]], before["observations.policy"][[0, 1, 3]])
    for name in ("mean", "var", "seen"):
        path = f"observations.policy.normalization.{name}"
        np.testing.assert_array_equal(world.state()[path], before[path])


def arrays(*values: Any) -> list[wp.array]:
    return [wp.array(np.asarray(v, dtype=np.float32), dtype=float, device="cpu") for v in values]


@pytest.mark.parametrize(("count", "parts"), [(70, 64), (64, 64), (3, 64), (1000, 7), (1, 1)])
def test_moments_are_sums_over_slices(count, parts):
    values = np.random.default_rng(count).normal(2.0, 0.5, size=(count + 2, 3)).astype(np.float32)
    values[count:] = np.nan  # beyond those that count
    mean = np.float32([0.0, 2.0, -1.0])
    x, n, m, sums, squares = arrays(values, np.ones(3), mean, *np.full((2, 3, parts), np.nan))
    wp.launch(processing.sum_moments, (3, parts), [x, count, n, m], [sums, squares], device="cpu")
    off = values[:count].astype(float) - mean
    np.testing.assert_allclose(sums.numpy().astype(float).sum(axis=1), off.sum(axis=0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(squares.numpy().astype(float).sum(axis=1), (off**2).sum(axis=0), rtol=1e-4)


def merged(batches: list[np.ndarray], update: int = 1) -> list[np.ndarray]:
    """Count, mean and variance after these batches, each ``(count, 2)``."""
    seen, mean, var, sums, squares = arrays(np.zeros(2), np.zeros(2), np.ones(2), np.zeros((2, 4)), np.zeros((2, 4)))
    flags = wp.array([0, update, 0], dtype=int, device="cpu")
    for batch in batches:
        count = len(batch)
        (x,) = arrays(batch)
        wp.launch(processing.sum_moments, (2, 4), [x, count, seen, mean], [sums, squares], device="cpu")
        given = [x, count, flags, 1, sums, squares]
        wp.launch(processing.merge_statistics, 2, given, [seen, mean, var], device="cpu")
    return [v.numpy().astype(float) for v in (seen, mean, var)]


def test_merged_statistics_are_those_of_all_samples_together():
    draw = np.random.default_rng(0)
    batches = [draw.normal(size=(n, 2)) * s + [m, -2.0] for n, s, m in ((5, 1.0, 3.0), (40, 0.1, -1.0), (1, 0.0, 9.0))]
    batches += [draw.normal(size=(50, 2)) + [k * 0.01, 0.0] for k in range(200)]
    for some in (batches[:1], batches[:2], batches[:3], batches):
        everything = np.concatenate(some).astype(np.float32).astype(float)
        seen, mean, var = merged(some)
        np.testing.assert_array_equal(seen, len(everything))
        np.testing.assert_allclose(mean, everything.mean(axis=0), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(var, everything.var(axis=0), rtol=1e-4)
    seen, mean, var = merged([np.full((3, 2), 7.0)])  # no spread, and no negative variance from rounding
    np.testing.assert_array_equal(mean, 7.0)
    assert (var >= 0.0).all()
    np.testing.assert_allclose(var, 0.0, atol=1e-5)


def test_statistics_are_held_where_their_flag_is_off():
    for value, expected in zip(merged([np.ones((3, 2))], update=0), (0.0, 0.0, 1.0), strict=True):
        np.testing.assert_array_equal(value, expected)
