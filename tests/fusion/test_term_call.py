# SPDX-License-Identifier: Apache-2.0
"""Term call: source code of the call of a bound term, and calls that differ in tuned numbers alone."""

from __future__ import annotations

from stripe_newton.envs import mdp
from stripe_newton.fusion import SceneEntityCfg, bind_term, code
from tests.helpers.fusion_terms import cart_energy


def test_fixed_arguments_and_counts(cart):
    call = bind_term(cart, cart_energy, {}, "rewards.x", "reward", {"mass": code("masses[env]")})
    assert call.expression().text.startswith("cart_energy(env, robot, ")
    assert call.expression().text.endswith(", masses[env])")
    assert call.expression().uses >= {"cart_energy", "robot"}
    assert call.counts == {"joint_ids": 2}
    observed = bind_term(cart, mdp.joint_pos, {}, "observations.policy.q", "observation")
    assert "policy[env, 3:5]" in observed.expression(code("policy[env, 3:5]")).text
    (part,) = (observed.expression(code("out"), sliced=["joint_ids"], span="k:k + 1").text,)
    assert part == "joint_pos(env, robot, joint_ids[k:k + 1], out)"


def test_calls_that_differ_in_tuned_numbers_alone(cart):
    def call(where: str, mass: float, joint: str):
        params = {"mass": mass, "asset_cfg": SceneEntityCfg("robot", joint_names=[joint])}
        return bind_term(cart, cart_energy, params, where, "reward")

    one, same, other = call("a", 1.0, "cart_to_pole"), call("b", 1.0, "cart_to_pole"), call("c", 1.0, "slider_to_cart")
    ((mine, its),) = one.differing_parameters(same)
    assert mine != its
    assert one.differing_parameters(one) == []
    assert one.differing_parameters(other) is None
