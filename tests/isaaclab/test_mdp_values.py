# SPDX-License-Identifier: Apache-2.0
"""Terms of ``isaaclab.envs.mdp`` beside Isaac Lab's own torch functions, on the same random states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from tests.helpers.isaaclab_source import isaaclab_source
from tests.helpers.isaaclab_terms import TERMS, Bench
from tests.helpers.isaaclab_walker import put, walker_task
from tests.helpers.small_scenes import numpy

N = 6


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    isaaclab_source()
    with walker_task(tmp_path_factory.mktemp("walker")) as task:
        made = Bench(task)
        yield made
        made.env.close()


@pytest.fixture(scope="module", params=["walking", "flying"])
def state(request: pytest.FixtureRequest, bench: Bench) -> str:
    """Robots on the ground after some steps, one of which has just been reset; and robots somewhere, at any speed."""
    env = bench.env
    torch.manual_seed(3)
    for _ in range(10):
        env.step(2.0 * torch.rand(N, 2) - 1.0)
    if request.param == "flying":
        put(env, seed=5)
    return request.param


@pytest.mark.parametrize("term", TERMS)
def test_a_term_has_the_value_of_isaac_labs_function(bench, state, term):
    expected, found = bench.value_of_isaac_lab(term), bench.value_of(term)
    expected = expected.reshape(found.shape).to(torch.float64)
    scale = float(expected.abs().max())
    np.testing.assert_allclose(numpy(found), numpy(expected), rtol=2e-5, atol=max(2e-5 * scale, 1e-6))
    params = bench.params(TERMS[term])
    again = getattr(bench.ours, term.split(".")[1])(bench.env, *params.values())
    assert torch.equal(found, again)


def test_the_states_tell_the_terms_apart(bench, state):
    """Few terms are the same in all environments, where they could be wrong unseen."""
    flat = []
    for term in TERMS:
        value = bench.value_of(term)
        flat += [term] if torch.equal(value, value[:1].expand_as(value)) else []
    assert len(flat) <= 16, flat
