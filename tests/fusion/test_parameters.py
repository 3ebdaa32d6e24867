# SPDX-License-Identifier: Apache-2.0
"""Parameters: values of all kinds, their errors, and kernels that read them without compiling again."""

from __future__ import annotations

import pytest
import torch
import warp as wp

from stripe_newton.envs import mdp
from stripe_newton.fusion import ParameterRead, Parameters, Scope, Section, code
from stripe_newton.managers import RewardManager, RewardTermCfg
from tests.helpers.fusion_terms import generated_files
from tests.helpers.manager_world import plan


def test_parameters_of_all_kinds():
    parameters = Parameters(Scope(), "cpu")
    given = {
        "a.float": (1.5, float),
        "a.int": (-3, int),
        "a.bool": (True, bool),
        "a.vec2": ((1.0, 2.0), wp.vec2),
        "a.vec3": ((1.0, 2.0, 3.0), wp.vec3),
        "a.quat": ((0.0, 0.0, 0.6, 0.8), wp.quat),
    }
    for path, (value, kind) in given.items():
        parameters.add(path, value, kind)
    assert parameters.paths() == list(given)
    for path, (value, kind) in given.items():
        assert parameters[path] == pytest.approx(value)
        assert type(parameters[path]) is (kind if kind in (float, int, bool) else tuple)
        assert path in parameters
    parameters["a.vec2"] = torch.tensor([4.0, 5.0])
    parameters["a.bool"] = False
    parameters["a.int"] = 7
    assert parameters["a.vec2"] == (4.0, 5.0)
    assert parameters["a.vec3"] == (1.0, 2.0, 3.0)
    assert parameters["a.bool"] is False
    assert parameters["a.int"] == 7
    assert "a.other" not in parameters


def test_wrong_parameters():
    parameters = Parameters(Scope(), "cpu")
    parameters.add("rewards.alive.weight", 1.0, float)
    parameters.add("rewards.alive.bounds", (0.0, 1.0), wp.vec2)
    parameters.add("count", 1, int)
    with pytest.raises(KeyError, match=r"no parameter 'rewards.alve.weight'; near it: rewards.alive.weight"):
        parameters["rewards.alve.weight"] = 2.0
    with pytest.raises(KeyError, match="no parameter 'zzzz'"):
        parameters["zzzz"]
    with pytest.raises(ValueError, match=r"rewards.alive.weight: is 'much', must be a number"):
        parameters["rewards.alive.weight"] = "much"
    with pytest.raises(ValueError, match=r"rewards.alive.bounds: is 1.0, must be 2 numbers"):
        parameters["rewards.alive.bounds"] = 1.0
    with pytest.raises(ValueError, match=r"count: is 1.5, must be a whole number"):
        parameters["count"] = 1.5
    for value in (2**31, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="must be a whole number of at most 2147483647"):
            parameters["count"] = value
    for value in (2**24 + 1, 2**31 - 1, -(2**31 - 1)):  # no numbers of float32
        parameters["count"] = value
        assert parameters["count"] == value
    with pytest.raises(ValueError, match="must be a number"):
        parameters.add("new", "x", float)
    assert "new" not in parameters
    assert parameters["rewards.alive.weight"] == 1.0


def test_parameters_in_source(cart):
    out = cart.array("result", float, 4)
    name, add = cart.scope.name("result", out), cart.parameters.add
    values = [("f", 2.0, float), ("b", True, bool), ("v", (3.0, 4.0), wp.vec2), ("n", 5, int)]
    f, b, v, n = (add(*value) for value in values)
    assert [isinstance(piece, ParameterRead) for piece in (f, b, v, n)] == [True, False, False, True]
    body = [code("{}[env, 0] = {}", name, f), code("{}[env, 1] = wp.where({}, 1.0, 0.0)", name, b)]
    body += [code("{}[env, 2] = ({})[0] * ({})[1]", name, v, v), code("{}[env, 3] = float({})", name, n)]
    work = plan(cart, [Section("read", body)])
    work.run()
    assert out.numpy().tolist() == [[2.0, 1.0, 12.0, 5.0]] * 4
    for path, value in (("f", 0.5), ("b", False), ("v", (2.0, 2.5)), ("n", -1)):
        cart.parameters[path] = value
    work.run()
    assert out.numpy().tolist() == [[0.5, 0.0, 5.0, -1.0]] * 4


def test_weight_changes_without_compiling(cart):
    manager = RewardManager({"alive": RewardTermCfg(mdp.is_alive, weight=2.0)}, cart, scale_by_dt=False)
    work = plan(cart, manager.compute_items())
    work.run()
    files, kernels = generated_files(), work.kernels
    assert wp.to_torch(cart.reward).tolist() == [2.0] * 4
    for weight in (-3.0, 0.0, 5.0):
        cart.parameters["rewards.alive.weight"] = weight
        work.run()
        assert wp.to_torch(cart.reward).tolist() == [weight] * 4
    assert work.kernels == kernels
    assert generated_files() == files
