# SPDX-License-Identifier: Apache-2.0
"""Training over regenerated scenes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stripe_newton.rl import (
    OnPolicyRunner,
    RslRlMLPModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
    RslRlVecEnvWrapper,
)
from tests.helpers.regenerate_world import N, make, scanner, small_hills, training


def runner(folder, count):
    env = RslRlVecEnvWrapper(make(3, training(small_hills(), sensors={"scanner": scanner()})))
    small = RslRlMLPModelCfg(hidden_dims=(8,))
    agent = RslRlOnPolicyRunnerCfg(
        num_steps_per_env=4,
        max_iterations=count,
        save_interval=1,
        regenerate_interval=2,
        experiment_name="hills",
        actor=RslRlMLPModelCfg(hidden_dims=(8,), distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg()),
        critic=small,
        algorithm=RslRlPpoAlgorithmCfg(num_learning_epochs=1, num_mini_batches=2),
    )
    torch.manual_seed(1)
    return OnPolicyRunner(env, agent, folder)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run of five iterations in three scenes, its folder, and what was seen after each iteration."""
    folder = tmp_path_factory.mktemp("whole")
    run = runner(folder, 5)
    env, storage = run.env.unwrapped, run.alg.storage
    seen = {"acted_on": [], "seeds": [], "observed": [], "lengths": []}
    run.logger.iteration_hooks += [
        lambda it: seen["acted_on"].extend(storage.observations["policy"].clone()),
        lambda it: seen["seeds"].append(env.scene.scenery_seed),
        lambda it: seen["observed"].append(env.obs_buf["policy"].clone()),
        lambda it: seen["lengths"].append(run.logger.cur_episode_length.sum()),
    ]
    run.learn()
    return run, folder, seen


@pytest.mark.parametrize("stop", [2, 3])
def test_training_goes_from_scene_to_scene_and_resumes(whole, tmp_path, stop):
    first, folder, seen = whole
    assert seen["seeds"] == [3, 4, 4, 5, 5]
    again = runner(tmp_path / "again", 5)
    again.resume(folder / "checkpoints" / f"model_{stop - 1}.pt")
    assert again.env.unwrapped.scene.scenery_seed == 4
    assert again.env.unwrapped.scene.first_scenery_seed == 3
    seeds = []
    again.logger.iteration_hooks.append(lambda it: seeds.append(again.env.unwrapped.scene.scenery_seed))
    again.learn()
    assert seeds == [4, 5, 5][stop - 2 :]
    heights = [r.env.unwrapped.scene.terrain.struct.heights.numpy() for r in (first, again)]
    np.testing.assert_array_equal(*heights)


def test_training_acts_on_the_first_observations_of_a_scene(whole):
    """The last ones of the old scene are forgotten; the episode's sums begin at zero."""
    seen = whole[2]
    assert torch.equal(seen["acted_on"][8], seen["observed"][1])
    assert not torch.equal(seen["acted_on"][7], seen["acted_on"][8])
    assert seen["lengths"][0] == 4 * N
    assert seen["lengths"][1] == 0
