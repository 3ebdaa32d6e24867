# SPDX-License-Identifier: Apache-2.0
"""Array arguments of terms: states that terms keep and share."""

from __future__ import annotations

import warp as wp

from stripe_newton.fusion import TermState
from stripe_newton.managers import MetricsManager, MetricTermCfg, RewardManager, RewardTermCfg
from tests.helpers.fusion_terms import count_up, problems_of
from tests.helpers.manager_world import plan


@wp.func
def read_counter(env: int, counter: wp.array[float]) -> float:
    return counter[env]


def test_terms_share_a_state(cart):
    counting = {
        "count": RewardTermCfg(count_up, {"counter": TermState("counter")}, weight=1.0),
        "other": RewardTermCfg(count_up, {"counter": TermState("other")}, weight=100.0),
    }
    rewards = RewardManager(counting, cart, scale_by_dt=False)
    metrics = MetricsManager({"read": MetricTermCfg(read_counter, {"counter": TermState("counter")})}, cart)
    work = plan(cart, rewards.compute_items(), metrics.compute_items())
    for _ in range(3):
        work.run()
    assert wp.to_torch(cart.arrays["state.counter"]).tolist() == [3.0] * 4
    assert wp.to_torch(cart.arrays["state.other"]).tolist() == [3.0] * 4
    assert wp.to_torch(cart.reward).tolist() == [303.0] * 4
    assert wp.to_torch(cart.arrays["metrics.sums"]).tolist() == [[1.0 + 2.0 + 3.0]] * 4


def test_state_of_a_wrong_shape(cart):
    text = problems_of(cart, count_up, {"counter": TermState("counter", shape=(3,))})
    assert "rewards.x.params.counter: is a state of float, shape (3,)" in text
