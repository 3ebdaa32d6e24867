# SPDX-License-Identifier: Apache-2.0
"""Training loop on gymnasium alone: the example of docs/learners.md."""

from __future__ import annotations

import pytest
import torch

from tests.helpers.learner_examples import blocks, cartpole, mean_return, one_thread, random_return, run_example


@pytest.fixture(autouse=True)
def threads():
    with one_thread():
        yield


def test_the_example_learns():
    actor = run_example("A loop of your own")["actor"]
    before = random_return()
    assert before < 30.0
    assert mean_return(actor) > before + 120.0


def test_every_example_of_the_page_is_run():
    """Here, in test_sb3.py and in test_skrl.py, in place of test_docs.py."""
    headings = ("A loop of your own", "Stable-Baselines3", "skrl")
    assert len(blocks()) == sum(len(blocks(heading)) for heading in headings) == 4


def test_the_final_observation_is_where_the_episode_would_have_gone_on():
    """Observations from which the example bootstraps; the twin's episodes do not end, so it sees the state itself."""
    short, long = cartpole(episode_length_s=0.2, compute_final_obs=True), cartpole(episode_length_s=5.0)
    short.reset(seed=3)
    long.reset(seed=3)
    for step in range(12):
        action = torch.sin(torch.arange(4.0) + step)[:, None]
        groups, reward, terminated, truncated, extras = short.step(action)
        expected, same, *_ = long.step(action)
        assert torch.equal(reward, same)
        assert ("final_obs" in extras) == (step == 11)
    assert truncated.all()
    assert not terminated.any()
    assert torch.equal(extras["final_obs"]["policy"], expected["policy"])
    assert not torch.equal(groups["policy"], expected["policy"])
