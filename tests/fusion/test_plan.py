# SPDX-License-Identifier: Apache-2.0
"""Plans: sections in order and under flags, host functions between kernels, and runs of some stages."""

from __future__ import annotations

import pytest
import warp as wp

from stripe_newton import fusion
from stripe_newton.fusion import Code, Flag, HostFunction, KernelLaunches, Plan, Section, Stage, code, may_use, only
from tests.helpers.fusion_terms import silent
from tests.helpers.manager_world import plan, run, set_reset


def numbers(context, name: str = "numbers"):
    array = context.array(name, float)
    return context.scope.name(name, array), wp.to_torch(array)


def added(name: Code, number: float) -> Code:
    return code("{n}[env] = {n}[env] + {number}", n=name, number=str(number))


def test_sections_run_in_order(cart):
    name, values = numbers(cart)
    order = []
    items = [
        Section("one", [code("local = {}[env] + 1.0", name), code("{}[env] = local", name)]),
        Section("two", [code("local = {}[env] * 10.0", name), code("{}[env] = local", name)]),
        KernelLaunches("middle", lambda: order.append(values.tolist())),
        Section("two", [code("{n}[env] = {n}[env] + float(env)", n=name)]),
        Section("empty", []),
    ]
    run(cart, items)
    assert order == [[10.0] * 4]
    assert values.tolist() == [10.0, 11.0, 12.0, 13.0]


def test_flags_are_combined_by_and(cart):
    name, values = numbers(cart)
    set_reset(cart, [False, True, True, False])
    wp.to_torch(cart.stepping)[:] = 0
    outside = Flag(0, cart.code("{stepping}[0] == 0"))
    ended = Section("ended", [added(name, 1.0)]).only(cart.is_reset)
    items = [
        ended,
        Section("within", [added(name, 10.0)]).only(cart.within_step),
        Section("both", [added(name, 100.0)]).only(cart.is_reset, outside),
        *only([KernelLaunches("always", lambda: None), Section("again", [added(name, 1000.0)])], cart.is_reset),
    ]
    assert ended.only(cart.is_reset) == ended
    assert ended.only(outside).when == {cart.is_reset, outside}
    assert ended.when == {cart.is_reset}
    work = plan(cart, items)
    work.run()
    assert values.tolist() == [0.0, 1101.0, 1101.0, 0.0]
    wp.to_torch(cart.stepping)[:] = 1
    work.run()
    assert values.tolist() == [10.0, 2112.0, 2112.0, 10.0]
    assert "if stepping[0] == 0 and reset[env]:" in work.kernels[0].source


def test_sections_may_be_called_like_arrays(cart):
    """As a command of the user may be called like a part of the step."""
    name, values = numbers(cart)
    step = cart.code("{n}[env] += float({step}[0])", n=name)
    run(cart, [Section(name.text, [added(name, 1.0)]), Section("step", [step])])
    assert values.tolist() == [1.0] * 4


def test_items_say_which_fields_they_may_use(cart):
    functions = cart.scope.functions
    robot = cart.scope.name("robot", cart.entity("robot").data.struct)
    direct = Section("direct", [code("x = {robot.joint_pos}[env, 0]", robot=robot)])
    calls = Section("calls", [cart.scope.call(silent, "env", robot)])
    for item in (direct, calls):
        assert may_use(item, {"joint_pos"}, functions)
        assert not may_use(item, {"joint_vel", "body_pose"}, functions)
    assert may_use(HostFunction("torch", lambda: None, "torch term"), {"body_pose"}, functions)
    assert may_use(KernelLaunches("unknown", lambda: None), {"body_pose"}, functions)
    assert not may_use(KernelLaunches("known", lambda: None, fields=frozenset({"joint_pos"})), {"body_pose"}, functions)
    assert may_use(KernelLaunches("known", lambda: None, fields=frozenset({"joint_pos"})), {"joint_pos"}, functions)


def test_eager_splits_the_step(cart):
    name, values = numbers(cart)

    def on_host():
        values.mul_(2.0)

    def plus_one(title: str) -> Section:
        return Section(title, [added(name, 1.0)], [f"term_{title}"])

    whole = plan(cart, [plus_one("a")], [plus_one("b")])
    split = plan(
        cart, [plus_one("a")], [HostFunction("rewards", on_host, "torch term 'mine'", ["mine"])], [plus_one("b")]
    )
    assert len(whole.kernels) == 1
    assert len(split.kernels) == 2
    split.run()
    assert values.tolist() == [3.0] * 4
    rows = split.rows()
    assert [how for stage, _, how in rows if stage == "part 1"] == ["eager: torch term 'mine'"]
    text = split.describe()
    for part in ("part 0", "part 1", "part 2", "mine", "term_a", "torch term 'mine'", "2 fused kernels"):
        assert part in text
    assert "graph launch" not in text
    assert "1 fused kernel" in whole.describe()
    assert split.kernels[0].source in split.describe(kernels=True)


def test_a_stage_without_items_has_a_row(cart):
    plan_ = Plan("test", [Stage("commands", [])], cart.scope, cart.num_envs, cart.device, use_graph=False)
    assert plan_.rows() == [("commands", "-", "-")]


def test_run_without_graph_runs_the_stages_named(cart):
    calls, (name, values) = [], numbers(cart)
    barrier = KernelLaunches("barrier", lambda: calls.append("barrier"))
    stages = [
        Stage("physics", [KernelLaunches("physics", lambda: calls.append("physics"))]),
        Stage("outcome", [Section("outcome", [added(name, 1.0)])]),
        Stage("host", [HostFunction("host", lambda: calls.append("host"), "torch")]),
        Stage("reset", [Section("reset_it", [added(name, 10.0)]), barrier]),
        Stage("observations", [Section("observe", [added(name, 100.0)])]),
    ]
    work = Plan("test", stages, cart.scope, cart.num_envs, cart.device, use_graph=False)
    work.run_without_graph(["reset", "observations"])
    assert calls == ["barrier"]
    assert values.tolist() == [110.0] * 4
    work.run_without_graph(["host"])
    assert calls == ["barrier", "host"]
    work.run()
    assert calls == ["barrier", "host", "physics", "host", "barrier"]
    assert values.tolist() == [221.0] * 4


def test_former_names_of_items_warn():
    for old, new in (("Captured", KernelLaunches), ("Eager", HostFunction)):
        with pytest.warns(DeprecationWarning, match=new.__name__):
            assert getattr(fusion, old) is new
