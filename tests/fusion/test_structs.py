# SPDX-License-Identifier: Apache-2.0
"""Struct resolvers: structs of a user's own as arguments of terms."""

from __future__ import annotations

import warp as wp

from stripe_newton.managers import RewardManager, RewardTermCfg
from tests.helpers.fusion_terms import problems_of
from tests.helpers.manager_world import run


@wp.struct
class Wind:
    """A struct of a user's own."""

    speed: wp.array[float]


@wp.func
def wind_speed(env: int, wind: Wind) -> float:
    return wind.speed[env]


def test_a_struct_of_a_users_own_is_bound_by_type_and_name(cart):
    assert problems_of(cart, wind_speed, {}).endswith("of which the environment has none")
    for name, speed in (("breeze", 2.0), ("storm", 30.0)):
        wind = Wind()
        wind.speed = wp.full(cart.num_envs, speed, dtype=float)
        cart.provide(wind, name)
    assert problems_of(cart, wind_speed, {}) == "rewards.x.params.wind: is missing, must name a Wind: breeze, storm"
    assert "is 'calm', must name a Wind: breeze, storm" in problems_of(cart, wind_speed, {"wind_name": "calm"})
    cart.problems.clear()
    terms = {n: RewardTermCfg(wind_speed, {"wind": n}, weight=1.0) for n in ("breeze", "storm")}
    run(cart, RewardManager(terms, cart, scale_by_dt=False).compute_items())
    assert wp.to_torch(cart.reward).tolist() == [32.0] * 4
