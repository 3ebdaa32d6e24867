# SPDX-License-Identifier: Apache-2.0
"""Hook recorder: state that hooks keep in any form is carried; hooks that a graph cannot hold are found and named."""

from __future__ import annotations

import contextlib
import copy
import random
import re
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from stripe_newton.envs.hook_graphs import HookGraphError, HookRecorder
from stripe_newton.envs.hook_graphs.reachable import scan
from tests.helpers.tape_graph import TapeGraph

STEPS = 24
SKIP = ("extras", "input", "recorder")


class World:
    """An environment of one hook and no simulation; ``input`` is new in each step."""

    def __init__(self, hook: Callable[[Any], None], recorded: bool, start: Callable[[Any], None], **options: Any):
        self.device, self.extras = "cpu", {"log": {}}
        self.input = torch.zeros(3)
        self.step_count = 0
        self.calls = [0]
        start(self)
        self.recorder = HookRecorder(self, SKIP, dict, self.record, contextlib.nullcontext, **options)
        self.hook = self.recorder.add("hook", lambda: hook(self), hook)
        self.recorded = recorded

    def record(self, function: Callable[[], None]) -> TapeGraph:
        before = self.recorder.context.snapshot()
        tape = TapeGraph(function)
        before.restore()
        return tape

    def step(self) -> dict[str, torch.Tensor]:
        self.extras = {"log": {}}
        self.input.copy_(torch.sin(torch.arange(3.0) + self.step_count))
        if self.recorded:
            self.recorder.begin_step()
        self.recorder.run(self.hook)
        if self.recorded:
            self.recorder.end_step()
        self.step_count += 1
        log = {f"log.{k}": torch.as_tensor(v).clone() for k, v in self.extras["log"].items()}
        return {"/".join(map(str, p)): t.clone() for p, t in scan(self, SKIP).tensors.items()} | log


def both(hook: Callable[[Any], None], start: Callable[[Any], None] = lambda env: None, steps: int = STEPS) -> World:
    """Run a hook eagerly and recorded; states must be the same, bit for bit, after each step. Returns the latter."""
    runs = []
    for recorded in (False, True):
        torch.manual_seed(7)
        world = World(hook, recorded, start)
        runs.append([world.step() for _ in range(steps)])
    for index, (eager, replayed) in enumerate(zip(*runs, strict=True)):
        assert eager.keys() == replayed.keys()
        for name in eager:
            assert torch.equal(eager[name], replayed[name]), f"step {index}: {name}"
    return world


def steps(world: World, count: int) -> None:
    for _ in range(count):
        world.step()


def is_replayed(world: World) -> bool:
    return world.hook.recorded and world.recorder.joined(world.hook)


# -- state that is carried


class Pair(NamedTuple):
    a: torch.Tensor
    b: torch.Tensor


class Filter:
    """An object of a task with state of its own, some of it in slots."""

    __slots__ = ("state",)

    def __init__(self) -> None:
        self.state = torch.zeros(3)


def start(env: Any) -> None:
    env.actions, env.previous, env.before = torch.zeros(3), torch.zeros(3), torch.zeros(3)
    env.one, env.two = torch.ones(3), torch.zeros(3)
    env.buffers = {"goal": torch.zeros(3), "list": [torch.zeros(3), torch.ones(3)]}
    env.history = deque([torch.zeros(3) for _ in range(3)], maxlen=3)
    env.pair, env.filter = Pair(torch.zeros(3), torch.ones(3)), Filter()
    env.space = SimpleNamespace(wide=torch.zeros(3, 3), part=torch.zeros(3))
    env.twin = env.same = torch.zeros(3)
    env.sums, env.expanded = torch.zeros(3), torch.zeros(3).expand(2, 3)


def shift(env: Any) -> None:
    env.before = env.previous
    env.previous = env.actions
    env.actions = env.input * 2.0


def swap(env: Any) -> None:
    env.one, env.two = env.two, env.one
    env.one = env.one + env.input


def nested(env: Any) -> None:
    env.buffers["goal"] = env.buffers["goal"] + env.input
    env.buffers["list"] = [env.buffers["list"][1], env.input.clone()]


def rolling(env: Any) -> None:
    env.history.append(env.input + env.history[0])


def in_objects(env: Any) -> None:
    env.pair = Pair(env.pair.b, env.input + env.pair.a)
    env.filter.state = 0.5 * env.filter.state + env.input


def views(env: Any) -> None:
    env.space.wide = torch.outer(env.input, env.input) + env.space.wide
    env.space.part = env.space.wide[:, 1]


def one_tensor_twice(env: Any) -> None:
    env.twin = env.same = env.input + env.same
    env.twin += 1.0


def in_place(env: Any) -> None:
    env.sums += env.input
    env.sums[env.sums > 1.0] = 0.0
    env.sums[torch.tensor([0, 2])] = env.sums[[0, 2]] + 0.5
    env.extras["log"]["sum"] = env.sums.sum()


def expanded(env: Any) -> None:
    env.expanded = (env.expanded[0] + env.input).expand(2, 3)


def random_numbers(env: Any) -> None:
    env.sums = env.sums + torch.randn(3) * torch.rand_like(env.input)


def chosen(env: Any) -> None:
    env.sums = torch.where(env.input > 0.0, 1.0, env.sums + 1.0) + torch.where(env.input < 0.0, 2, 3)


@pytest.mark.parametrize(
    "hook",
    [shift, swap, nested, rolling, in_objects, views, one_tensor_twice, in_place, expanded, random_numbers, chosen],
)
def test_state_carries_over(hook):
    assert is_replayed(both(hook, start)), hook.__name__


def test_a_replay_runs_no_python():
    """What makes the tests above worth something: the code of a hook does not run again."""

    def hook(env: Any) -> None:
        ran.append(1)
        env.sums = env.sums + env.input

    ran: list[int] = []
    world = World(hook, True, start)
    for _ in range(40):
        world.step()
    count = len(ran)
    assert is_replayed(world)
    world.step()
    assert len(ran) == count


def test_a_hook_with_numbers_that_somebody_changes_is_recorded_again():
    def hook(env: Any) -> None:
        env.sums = env.sums + env.cfg["gain"] * env.input

    def begin(env: Any) -> None:
        start(env)
        env.cfg = {"gain": 1.0}

    runs = []
    for recorded in (False, True):
        world = World(hook, recorded, begin)
        for index in range(60):
            if index in (30, 45):
                world.cfg["gain"] = 3.0 if index == 30 else torch.full((3,), 2.0)
            world.step()
        runs.append(world.sums.clone())
    assert torch.equal(*runs)
    assert is_replayed(world)


def test_a_tensor_that_somebody_replaces_is_read():
    def hook(env: Any) -> None:
        env.sums = env.sums + env.goal

    def begin(env: Any) -> None:
        start(env)
        env.goal = torch.ones(3)

    runs = []
    for recorded in (False, True):
        world = World(hook, recorded, begin)
        for index in range(60):
            if index in (20, 40):
                world.goal = torch.full((3,), float(index))
            world.step()
        runs.append(world.sums.clone())
    assert torch.equal(*runs)
    assert is_replayed(world)


def test_the_log_of_each_step_is_its_own():
    def hook(env: Any) -> None:
        env.sums = env.sums + env.input
        env.extras["log"]["sum"] = env.sums.sum()
        env.extras["seen"] = {"part": env.sums[:2]}

    world = World(hook, True, start)
    kept = []
    for _ in range(STEPS):
        world.step()
        kept.append((world.extras["seen"]["part"], world.extras["seen"]["part"].clone()))
    assert is_replayed(world)
    assert all(torch.equal(now, then) for now, then in kept)
    assert len({tuple(now.tolist()) for now, _ in kept}) > STEPS // 2


def test_what_is_logged_has_memory_of_its_own():
    """Memory that the recordings of a hook share; that of a recording may be written by another graph."""

    def hook(env: Any) -> None:
        env.extras["log"]["sum"] = env.input.sum()
        env.extras["log"]["kept"] = env.sums

    world = World(hook, True, start)
    steps(world, STEPS)
    world.extras = {"log": {}}
    first, second = world.hook.launch(), world.hook.launch()
    memory = world.hook.extras_memory.tensors["extras['log']['sum']"]
    assert first.extras["log"]["sum"] is memory
    assert second.extras["log"]["sum"] is memory
    assert first.extras["log"]["kept"] is world.sums  # a later hook may write it in place


def test_only_variants_that_come_often_are_recorded():
    def hook(env: Any) -> None:
        env.sums = env.sums + env.input[: env.calls[0]].sum()

    world = World(hook, True, start)
    world.hook.joins = False
    often = 1
    steps(world, HookRecorder.WARM + 1)
    for variant in range(2, 2 + HookRecorder.WINDOW):
        world.recorder.begin_step()
        world.recorder.run(world.hook, variant)
        world.recorder.end_step()
    assert world.hook.variants == 0
    found = []
    for _ in range(HookRecorder.OFTEN + 1):
        world.recorder.begin_step()
        world.recorder.run(world.hook, often)
        world.recorder.end_step()
        found.append(world.hook.has_graph(often))
    assert found == [False] * HookRecorder.OFTEN + [True]  # watched, then recorded


def test_without_hooks_graphs_are_launched_at_once():
    world = World(shift, True, start)
    world.recorder.hooks.clear()
    world.recorder.begin_step()
    assert world.recorder.replays
    world.recorder.end_step()


# -- what a graph cannot hold

COUNT = 0


def reads_a_value(env: Any) -> None:
    if env.input[0] > 0.5:
        env.sums += 1.0


def reads_an_item(env: Any) -> None:
    env.sums += env.input.max().item()


def makes_a_list(env: Any) -> None:
    env.sums += sum(env.input.tolist())


def counts(env: Any) -> None:
    env.step_number = getattr(env, "step_number", 0) + 1
    env.sums += 0.0 if env.step_number < 1000 else 1.0


def reads_the_step(env: Any) -> None:
    env.sums += 0.0 if env.step_count < 1000 else 1.0


def counts_globally(env: Any) -> None:
    global COUNT
    COUNT += 1
    env.sums += env.input


def lengthens(env: Any) -> None:
    env.calls.append(1)


def picks(env: Any) -> None:
    env.sums += env.input[env.input > 0.0].sum()


def finds(env: Any) -> None:
    env.sums[(env.input > 0.0).nonzero().flatten()] = 1.0


def draws_on_the_host(env: Any) -> None:
    env.sums += random.random() < 1e-9


def draws_with_numpy(env: Any) -> None:
    env.sums += float(np.random.rand() < 1e-9)  # noqa: NPY002  (as users do)


def changes_shape(env: Any) -> None:
    env.one = torch.cat((env.one, env.input[:1]))


def sometimes_shares(env: Any) -> None:
    env.one = env.two if env.calls[0] % 2 else env.input.clone()
    env.calls[0] += 1


REASONS = {
    reads_a_value: "__bool__.* reads the value of a tensor",
    reads_an_item: r"item\(\) reads the value",
    makes_a_list: r"tolist\(\) reads the value",
    counts: "step_number changes on the host, from",
    reads_the_step: "reads step_count, a number that changes from",
    counts_globally: "reads COUNT, a number that changes from",
    lengthens: "calls changes its length",
    picks: r"the size of x\[mask\] depends on values",
    finds: r"the size of what nonzero\(\) returns depends on values",
    draws_on_the_host: "draws random numbers on the host",
    draws_with_numpy: "draws random numbers on the host",
    changes_shape: r"one changes from float32 \(\d+,\) to float32",
    sometimes_shares: r"calls\[0\] changes on the host",
}


@pytest.mark.parametrize("hook", REASONS, ids=lambda hook: hook.__name__)
def test_what_a_graph_cannot_hold_stays_eager_with_its_line(hook):
    random.seed(1)
    world = both(hook, start, 16) if hook not in (draws_on_the_host, draws_with_numpy) else World(hook, True, start)
    for _ in range(16):
        world.step()
    assert not world.hook.recorded
    world.recorder.begin_step()
    assert world.recorder.replays  # graphs of kernels go on
    world.recorder.end_step()
    where, _, what = world.hook.reason.partition(": ")
    file, _, line = where.partition(":")
    assert file == "envs/test_hook_recorder.py"
    code = hook.__code__
    assert code.co_firstlineno <= int(line) <= code.co_firstlineno + 4
    assert re.search(REASONS[hook], what), what


def test_a_reason_is_an_error_where_recording_is_required():
    world = World(reads_an_item, True, start, required=True)
    with pytest.raises(HookGraphError, match=r"hook: envs/test_hook_recorder.py:\d+: item\(\) reads"):
        steps(world, 8)


class Hidden:
    """State that no walk through attributes finds: it is kept in a function."""

    def __init__(self) -> None:
        self.calls = copy.copy(self._count())

    def _count(self) -> Callable[[], int]:
        count = [0]

        def call() -> int:
            count[0] += 1
            return count[0]

        return call


def test_a_replay_that_gives_something_else_is_found():
    """By comparison, where nothing else gives it away."""
    counter = Hidden().calls

    def hook(env: Any) -> None:
        env.sums = env.sums + counter()

    world = World(hook, True, start)
    for _ in range(16):
        world.step()
    assert not world.hook.recorded
    assert "gives another 'sums' when it is replayed" in world.hook.reason


def test_late_changes_are_found_by_later_comparisons():
    """A number that no walk finds and that changes after the first steps."""
    gain = [1.0]

    def hook(env: Any) -> None:
        env.sums = env.input * gain[0]

    world = World(hook, True, start)
    for _ in range(30):
        world.step()
    assert is_replayed(world)
    gain[0] = 2.0
    for _ in range(HookRecorder.NEXT_CHECK):
        world.step()
    assert "gives another 'sums'" in world.hook.reason
    assert torch.equal(world.sums, 2.0 * world.input)


def test_an_error_of_a_hook_is_an_error():
    def hook(env: Any) -> None:
        raise RuntimeError("mine")

    world = World(hook, True, start)
    with pytest.raises(RuntimeError, match=r"^mine$"):
        steps(world, 8)
