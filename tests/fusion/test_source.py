# SPDX-License-Identifier: Apache-2.0
"""Source code: pieces of text that know the names and fields of structs in them."""

from __future__ import annotations

import pytest
import warp as wp

from stripe_newton.fusion import Code, Scope, block, code
from tests.helpers.fusion_terms import count_up


def test_source_knows_the_names_that_it_uses():
    scope = Scope()
    joint_pos, pos = (scope.name(n, wp.zeros(1, dtype=float)) for n in ("joint_pos", "pos"))
    line = code("{}[env] = {thing}.pos + {}  # pos", joint_pos, 1, thing="thing")
    assert line == Code("joint_pos[env] = thing.pos + 1  # pos", frozenset({"joint_pos"}))
    call = scope.call(count_up, "env", code("{}[{}]", pos, "k"))
    assert call.text == "count_up(env, pos[k])"
    assert scope.used(call.uses) == (["pos"], ["count_up"])
    nested = block(code("if {}:", call), [line])
    assert [piece.text for piece in nested] == ["if count_up(env, pos[k]):", f"    {line.text}"]
    assert nested[1].uses == line.uses
    assert block(code("else:"), [])[1].text == "    pass"


def test_source_knows_the_fields_of_structs(cart):
    robot = cart.scope.name("robot", cart.entity("robot").data.struct)
    line = code("{robot.joint_pos}[env, 0] = {}", 0, robot=robot)
    assert line.text == "robot.joint_pos[env, 0] = 0"
    assert line.uses == {"robot", "robot.joint_pos"}
    with pytest.raises(
        AttributeError, match="'robot' has no field 'joint_position'; it has body_acc, body_parent_wrench"
    ):
        code("{robot.joint_position}", robot=robot)


def test_source_in_an_f_string_is_an_error():
    """It would lose the names that it uses."""
    name = Scope().name("values", wp.zeros(1, dtype=float))
    with pytest.raises(TypeError, match=r"'values' is source code in an f-string, write it with code"):
        f"{name}[env]"
    with pytest.raises(TypeError, match=r"'\{\} = 1': a part is array, must be source code or text"):
        code("{} = 1", wp.zeros(1, dtype=float))
