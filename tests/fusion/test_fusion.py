# SPDX-License-Identifier: Apache-2.0
"""Fusion: names, parameters, the log, terms bound by their annotations, generated source, and plans of steps."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.envs import mdp
from stripe_newton.fusion import (
    Captured,
    Code,
    Eager,
    EpisodeLog,
    Flag,
    Parameters,
    Plan,
    SceneEntityCfg,
    Scope,
    Section,
    Stage,
    TermState,
    TunedNumber,
    bind_term,
    block,
    code,
    may_use,
    only,
)
from stripe_newton.managers import MetricsManager, MetricTermCfg, RewardManager, RewardTermCfg
from tests.helpers.manager_world import manager_context, plan, run, set_reset


@wp.func
def cart_energy(env: int, robot: ArticulationData, joint_ids: wp.array[int], mass: float) -> float:
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        speed = robot.joint_vel[env, joint_ids[i]]
        total += 0.5 * mass * speed * speed
    return total


@wp.func
def returns_bool(env: int, limit: float) -> bool:
    return float(env) > limit


@wp.func
def no_annotation(env: int, limit: float):
    return limit


@wp.func
def count_up(env: int, counter: wp.array[float]) -> float:
    counter[env] = counter[env] + 1.0
    return counter[env]


@wp.func
def read_counter(env: int, counter: wp.array[float]) -> float:
    return counter[env]


@wp.func
def silent(env: int, robot: ArticulationData):
    robot.joint_pos[env, 0] = 0.0


@pytest.fixture
def cart():
    return manager_context(robot="cartpole")


def problems_of(context, func, params, kind="reward") -> str:
    before = len(context.problems)
    assert bind_term(context, func, params, "rewards.x", kind) is None
    return "\n".join(context.problems[before:])


def all_of(manager: RewardManager) -> list:
    """Items until the reward of the step is there."""
    return [*manager.compute(), *getattr(manager, "total", list)()]


def generated() -> set[str]:
    folder = Path(wp.config.kernel_cache_dir) / "stripe_newton"
    return {p.name for p in folder.glob("*")} if folder.exists() else set()


# -- names


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


# -- source


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


# -- parameters


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
    with pytest.raises(ValueError, match="must be a number"):
        parameters.add("new", "x", float)
    assert "new" not in parameters
    assert parameters["rewards.alive.weight"] == 1.0


def test_parameters_in_source(cart):
    out = cart.array("result", float, 4)
    name, add = cart.scope.name("result", out), cart.parameters.add
    values = [("f", 2.0, float), ("b", True, bool), ("v", (3.0, 4.0), wp.vec2), ("n", 5, int)]
    f, b, v, n = (add(*value) for value in values)
    assert [isinstance(piece, TunedNumber) for piece in (f, b, v, n)] == [True, False, False, True]
    body = [code("{}[env, 0] = {}", name, f), code("{}[env, 1] = wp.where({}, 1.0, 0.0)", name, b)]
    body += [code("{}[env, 2] = ({})[0] * ({})[1]", name, v, v), code("{}[env, 3] = float({})", name, n)]
    work = plan(cart, [Section("read", body)])
    work.run()
    assert out.numpy().tolist() == [[2.0, 1.0, 12.0, 5.0]] * 4
    for path, value in (("f", 0.5), ("b", False), ("v", (2.0, 2.5)), ("n", -1)):
        cart.parameters[path] = value
    work.run()
    assert out.numpy().tolist() == [[0.5, 0.0, 5.0, -1.0]] * 4


# -- the log


def test_log(cart):
    log = cart.log
    lines = [
        log.line("ended", "float(env) + 1.0", "mean"),
        log.line("how_many", "1.0", "count"),
    ]
    section = Section("log_lines", lines).only(cart.is_reset)
    last = Section("level", block(code("if env == 0:"), [log.line("level", cart.code("float({step}[0])"), "last")]))
    work = plan(cart, [section, last, Captured("log", log.finish)])
    values = wp.to_torch(log.values)
    got = []
    for step, mask in enumerate([[1, 0, 1, 0], [0, 0, 0, 0], [0, 0, 0, 1]]):
        set_reset(cart, [bool(m) for m in mask])
        wp.to_torch(cart.step)[:] = step
        work.run()
        got.append(dict(zip(log.keys, values.tolist(), strict=False)))
    assert log.keys == ["ended", "how_many", "level"]
    assert got[0] == {"ended": 2.0, "how_many": 2.0, "level": 0.0}
    assert got[1] == {"ended": 2.0, "how_many": 0.0, "level": 1.0}
    assert got[2] == {"ended": 4.0, "how_many": 1.0, "level": 2.0}


def test_log_keys():
    log = EpisodeLog(Scope(), "cpu")
    assert [log.add("a"), log.add("b", "count"), log.add("a")] == [0, 1, 0]
    with pytest.raises(ValueError, match="log 'c': kind is 'sum', must be one of mean, count, last"):
        log.add("c", "sum")


# -- terms


def test_own_term_by_one_line_of_config(cart):
    cart.entity("robot").data.joint_vel[:] = torch.tensor([[1.0, 2.0]]) * torch.arange(4.0)[:, None]
    params = {"asset_cfg": SceneEntityCfg("robot", joint_names=["cart_to_pole"]), "mass": 3.0}
    manager = RewardManager({"energy": RewardTermCfg(cart_energy, params, weight=-0.5)}, cart, scale_by_dt=False)
    run(cart, all_of(manager))
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
    before = generated()
    wrong = {
        "one": RewardTermCfg(cart_energy, {"masss": 1.0}, weight=1.0),
        "two": RewardTermCfg(returns_bool, {"limit": 1.0, "more": 2.0}, weight=1.0),
        "three": RewardTermCfg(cart_energy, {"mass": 1.0, "asset_cfg": SceneEntityCfg("cube")}, weight=1.0),
        "four": "alive",
    }
    RewardManager(wrong, cart).compute()
    paths = {p.partition(":")[0] for p in cart.problems}
    assert paths >= {
        "rewards.one.params.mass",
        "rewards.one.params.masss",
        "rewards.two.func",
        "rewards.two.params.more",
        "rewards.four",
    }
    assert any(p.startswith("rewards.three") and "cube" in p for p in cart.problems)
    assert generated() == before


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
    ((mine, its),) = one.tuned_apart(same)
    assert mine != its
    assert one.tuned_apart(one) == []
    assert one.tuned_apart(other) is None


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
    run(cart, all_of(RewardManager(terms, cart, scale_by_dt=False)))
    assert wp.to_torch(cart.reward).tolist() == [32.0] * 4


def test_terms_share_a_state(cart):
    counting = {
        "count": RewardTermCfg(count_up, {"counter": TermState("counter")}, weight=1.0),
        "other": RewardTermCfg(count_up, {"counter": TermState("other")}, weight=100.0),
    }
    rewards = RewardManager(counting, cart, scale_by_dt=False)
    metrics = MetricsManager({"read": MetricTermCfg(read_counter, {"counter": TermState("counter")})}, cart)
    work = plan(cart, all_of(rewards), metrics.compute())
    for _ in range(3):
        work.run()
    assert wp.to_torch(cart.arrays["state.counter"]).tolist() == [3.0] * 4
    assert wp.to_torch(cart.arrays["state.other"]).tolist() == [3.0] * 4
    assert wp.to_torch(cart.reward).tolist() == [303.0] * 4
    assert wp.to_torch(cart.arrays["metrics.sums"]).tolist() == [[1.0 + 2.0 + 3.0]] * 4


def test_state_of_a_wrong_shape(cart):
    text = problems_of(cart, count_up, {"counter": TermState("counter", shape=(3,))})
    assert "rewards.x.params.counter: is a state of float, shape (3,)" in text


def test_weight_changes_without_compiling(cart):
    manager = RewardManager({"alive": RewardTermCfg(mdp.is_alive, weight=2.0)}, cart, scale_by_dt=False)
    work = plan(cart, all_of(manager))
    work.run()
    files, kernels = generated(), work.kernels
    assert wp.to_torch(cart.reward).tolist() == [2.0] * 4
    for weight in (-3.0, 0.0, 5.0):
        cart.parameters["rewards.alive.weight"] = weight
        work.run()
        assert wp.to_torch(cart.reward).tolist() == [weight] * 4
    assert work.kernels == kernels
    assert generated() == files


# -- generated source


def kernel_of(func, weight: float = 1.0):
    context = manager_context(robot="cartpole")
    manager = RewardManager({"own": RewardTermCfg(func, weight=weight)}, context, scale_by_dt=False)
    work = plan(context, all_of(manager))
    work.run()
    (kernel,) = (k for k in work.kernels if "own" in k.terms)
    return kernel, wp.to_torch(context.reward).tolist()


def written_term(folder: Path, name: str, body: str):
    path = folder / f"{name}.py"
    path.write_text(f"import warp as wp\n\n\n@wp.func\ndef own_term(env: int) -> float:\n    return {body}\n")
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.own_term


def test_source_is_a_readable_file(tmp_path):
    kernel, _ = kernel_of(written_term(tmp_path, "terms_readable", "float(env)"))
    assert kernel.path.read_text() == kernel.source
    assert "own_term(env)" in kernel.source
    assert "# own" in kernel.source
    assert max(map(len, kernel.source.splitlines())) < 200
    compile(kernel.source, str(kernel.path), "exec")


def test_equal_kernels_share_a_file_and_changed_terms_do_not(tmp_path):
    term = written_term(tmp_path, "terms_before", "2.0 * float(env)")
    first, rewards = kernel_of(term)
    again, _ = kernel_of(term, weight=3.0)
    changed, others = kernel_of(written_term(tmp_path, "terms_after", "3.0 * float(env)"))
    assert first.path == again.path
    assert first.path != changed.path
    assert rewards == [0.0, 2.0, 4.0, 6.0]
    assert others == [0.0, 3.0, 6.0, 9.0]


@pytest.fixture
def helper_terms(tmp_path):
    """A term that calls a helper, twice: the term alike, the helper not."""

    def make(name: str, factor: str):
        path = tmp_path / f"{name}.py"
        path.write_text(
            "import warp as wp\n\n\n@wp.func\ndef helper(x: float) -> float:\n"
            f"    return {factor} * x\n\n\n@wp.func\ndef own_term(env: int) -> float:\n    return helper(float(env))\n"
        )
        spec = importlib.util.spec_from_file_location(name, path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.own_term

    return make


def test_a_change_in_what_a_term_calls_counts(helper_terms):
    _, rewards = kernel_of(helper_terms("terms_helper_a", "2.0"))
    _, others = kernel_of(helper_terms("terms_helper_b", "5.0"))
    assert rewards == [0.0, 2.0, 4.0, 6.0]
    assert others == [0.0, 5.0, 10.0, 15.0]


# -- plans


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
        Captured("middle", lambda: order.append(values.tolist())),
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
        *only([Captured("always", lambda: None), Section("again", [added(name, 1000.0)])], cart.is_reset),
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
    assert may_use(Eager("torch", lambda: None, "torch term"), {"body_pose"}, functions)
    assert may_use(Captured("unknown", lambda: None), {"body_pose"}, functions)
    assert not may_use(Captured("known", lambda: None, fields=frozenset({"joint_pos"})), {"body_pose"}, functions)
    assert may_use(Captured("known", lambda: None, fields=frozenset({"joint_pos"})), {"joint_pos"}, functions)


def test_eager_splits_the_step(cart):
    name, values = numbers(cart)

    def on_host():
        values.mul_(2.0)

    def plus_one(title: str) -> Section:
        return Section(title, [added(name, 1.0)], [f"term_{title}"])

    whole = plan(cart, [plus_one("a")], [plus_one("b")])
    split = plan(cart, [plus_one("a")], [Eager("rewards", on_host, "torch term 'mine'", ["mine"])], [plus_one("b")])
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
    barrier = Captured("barrier", lambda: calls.append("barrier"))
    stages = [
        Stage("physics", [Captured("physics", lambda: calls.append("physics"))]),
        Stage("outcome", [Section("outcome", [added(name, 1.0)])]),
        Stage("host", [Eager("host", lambda: calls.append("host"), "torch")]),
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
