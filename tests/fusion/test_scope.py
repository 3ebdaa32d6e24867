# SPDX-License-Identifier: Apache-2.0
"""Scope: one valid name for each array and function, and none for numbers."""

from __future__ import annotations

import pytest
import torch
import warp as wp

from stripe_newton.fusion import Scope
from tests.helpers.fusion_terms import count_up


def test_one_name_per_value():
    scope, one, two = Scope(), wp.zeros(3, dtype=float), wp.zeros(3, dtype=float)
    assert scope.name("x", one).text == "x"
    assert scope.name("y", one).text == "x"
    assert scope.name("x", two).text == "x_2"
    assert scope.values == {"x": one, "x_2": two}
    assert scope.function(count_up).text == "count_up"
    assert scope.function(count_up).text == "count_up"
    assert scope.name("count_up", wp.zeros(1, dtype=int)).text == "count_up_2"


def test_names_are_those_of_neither_python_nor_cpp():
    scope, names = Scope(), []
    for wish in ("env", "wp", "class", "template", "lambda", "out", "rewards.a-b", "3d"):
        name = scope.name(wish, wp.zeros(2, dtype=float)).text
        assert name.isidentifier()
        names.append(name)
    assert names[:6] == ["env_2", "wp_2", "class_2", "template_2", "lambda_2", "out_2"]
    assert names[6] == "rewards_a_b"


@pytest.mark.parametrize("value", [1.0, 3, True, "x", None, torch.zeros(2)])
def test_numbers_have_no_names(value):
    with pytest.raises(TypeError, match=f"'speed': is {type(value).__name__}, must be a Warp array"):
        Scope().name("speed", value)
