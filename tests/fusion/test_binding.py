# SPDX-License-Identifier: Apache-2.0
"""Binding: arguments of terms found in their configs, and the problems reported where they are not."""

from __future__ import annotations

import torch
import warp as wp

from stripe_newton.fusion import SceneEntityCfg
from stripe_newton.managers import RewardManager, RewardTermCfg
from tests.helpers.fusion_terms import cart_energy, generated_files, problems_of, silent
from tests.helpers.manager_world import run


@wp.func
def returns_bool(env: int, limit: float) -> bool:
    return float(env) > limit


@wp.func
def no_annotation(env: int, limit: float):
    return limit


def test_own_term_by_one_line_of_config(cart):
    cart.entity("robot").data.joint_vel[:] = torch.tensor([[1.0, 2.0]]) * torch.arange(4.0)[:, None]
    params = {"asset_cfg": SceneEntityCfg("robot", joint_names=["cart_to_pole"]), "mass": 3.0}
    manager = RewardManager({"energy": RewardTermCfg(cart_energy, params, weight=-0.5)}, cart, scale_by_dt=False)
    run(cart, manager.compute_items())
    expected = -0.5 * 0.5 * 3.0 * (2.0 * torch.arange(4.0)) ** 2
    torch.testing.assert_close(wp.to_torch(cart.reward), expected)
    assert cart.parameters["rewards.energy.mass"] == 3.0


def test_unknown_argument(cart):
    text = problems_of(cart, cart_energy, {"masss": 1.0, "mass": 1.0})
    assert text == "rewards.x.params.masss: 'cart_energy' has no such argument; did you mean 'mass'?"
    text = problems_of(cart, cart_energy, {"quux": 1.0, "mass": 1.0})
    assert "it takes robot, joint_ids, mass" in text


def test_missing_argument(cart):
    assert problems_of(cart, cart_energy, {}) == "rewards.x.params.mass: is missing, 'cart_energy' needs it"
    assert "is 'heavy', must be a number" in problems_of(cart, cart_energy, {"mass": "heavy"})


def test_missing_entity(cart):
    text = problems_of(cart, cart_energy, {"mass": 1.0, "asset_cfg": SceneEntityCfg("cube")})
    assert "no asset or sensor 'cube' in the scene; it has robot" in text


def test_joints_that_are_not_there(cart):
    params = {"mass": 1.0, "asset_cfg": SceneEntityCfg("robot", joint_names=["wheel_.*"])}
    text = problems_of(cart, cart_energy, params)
    assert "wheel_.*" in text
    assert "slider_to_cart" in text
    assert "cart_to_pole" in text


def test_wrong_functions(cart):
    assert "'returns_bool' returns bool, a reward must be annotated '-> float'" in problems_of(
        cart, returns_bool, {"limit": 1.0}
    )
    assert "no return annotation, a reward must be annotated '-> float'" in problems_of(
        cart, no_annotation, {"limit": 1.0}
    )
    assert "a termination must be annotated '-> bool'" in problems_of(cart, cart_energy, {"mass": 1.0}, "termination")
    assert "has no argument 'out: wp.array[float]'" in problems_of(cart, silent, {}, "observation")
    assert "must be a Warp function (@wp.func)" in problems_of(cart, lambda env: 0.0, {})


def test_all_problems_at_once_and_nothing_is_compiled(cart):
    before = generated_files()
    wrong = {
        "one": RewardTermCfg(cart_energy, {"masss": 1.0}, weight=1.0),
        "two": RewardTermCfg(returns_bool, {"limit": 1.0, "more": 2.0}, weight=1.0),
        "three": RewardTermCfg(cart_energy, {"mass": 1.0, "asset_cfg": SceneEntityCfg("cube")}, weight=1.0),
        "four": "alive",
    }
    RewardManager(wrong, cart).compute_items()
    paths = {p.partition(":")[0] for p in cart.problems}
    assert paths >= {
        "rewards.one.params.mass",
        "rewards.one.params.masss",
        "rewards.two.func",
        "rewards.two.params.more",
        "rewards.four",
    }
    assert any(p.startswith("rewards.three") and "cube" in p for p in cart.problems)
    assert generated_files() == before
