# SPDX-License-Identifier: Apache-2.0
"""Event manager: times and numbers of events, against plain references."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ArticulationData
from stripe_kernels.mdp import random
from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.fusion import HostFunction
from stripe_newton.managers import EventManager, EventTermCfg, SceneEntityCfg, TermState, prestartup_events
from stripe_newton.sim import CuboidCfg, MassPropertiesCfg, RigidBodyPropertiesCfg
from tests.helpers.manager_world import manager_context, plan, run, set_reset
from tests.helpers.term_reference_random import Stream

DT, STEPS = 1.0 / 60.0, 50


@wp.func
def note(env: int, rng: wp.array[wp.uint32], runs: wp.array[int], drawn: wp.array[float]):
    runs[env] = runs[env] + 1
    drawn[env] = random.uniform(env, rng)


@wp.func
def stretch(env: int, robot: ArticulationData, joint_ids: wp.array[int], pos: float):
    for i in range(joint_ids.shape[0]):
        robot.joint_pos[env, joint_ids[i]] = pos


def noting(name: str, **fields: Any) -> EventTermCfg:
    state = {"runs": TermState(f"{name}_runs", int), "drawn": TermState(f"{name}_drawn", float)}
    return EventTermCfg(func=note, params=state, **fields)


class Calls:
    """Arguments with which torch terms were called."""

    def __init__(self):
        self.by_name: dict[str, list[tuple[int, list[int]]]] = {}
        self.now = 0

    def term(self, name: str, **fields: Any) -> EventTermCfg:
        calls = self.by_name[name] = []

        def func(env, env_ids, value):
            assert env is self
            assert value == 3.0
            assert env_ids is None or env_ids.dtype is torch.int64
            calls.append((self.now, env_ids.tolist() if env_ids is not None else None))

        return EventTermCfg(func=func, params={"value": 3.0}, **fields)


def state(context: Any, name: str) -> np.ndarray:
    return context.arrays[f"state.{name}"].numpy()


SHORT, LONG = (0.02, 0.15), (0.05, 0.2)
MIN_STEPS = 7


def events(calls: Calls) -> dict[str, EventTermCfg]:
    glob = {"mode": "interval", "is_global_time": True}
    return {
        "often": noting("often", mode="interval", interval_range_s=SHORT),
        "at_reset": noting("at_reset", mode="reset"),
        "spaced": noting("spaced", mode="reset", min_step_count_between_reset=MIN_STEPS),
        "torch_at_reset": calls.term("torch_at_reset", mode="reset"),
        "torch_spaced": calls.term("torch_spaced", mode="reset", min_step_count_between_reset=MIN_STEPS),
        "after_torch": noting("after_torch", mode="reset"),
        "torch_often": calls.term("torch_often", mode="interval", interval_range_s=LONG),
        "all": noting("all", interval_range_s=SHORT, **glob),
        "torch_all": calls.term("torch_all", interval_range_s=LONG, **glob),
        "always": noting("always", mode="step"),
        "torch_always": calls.term("torch_always", mode="step"),
    }


class Reference:
    """The same in plain Python: one environment after the other, clocks in whole steps."""

    def __init__(self, num_envs: int, seed: int):
        self.num_envs, self.stream = num_envs, Stream(seed, num_envs)
        self.runs = {
            n: np.zeros(num_envs, int) for n in ("often", "at_reset", "spaced", "after_torch", "all", "always")
        }
        self.drawn = {n: np.zeros(num_envs, np.float32) for n in self.runs}
        self.calls: dict[str, list[tuple[int, list[int]]]] = {}
        self.clocks = {n: np.zeros(num_envs, int) for n in ("often", "torch_often")}
        self.global_clocks = {"all": 0, "torch_all": 0}
        self.last = {n: [None] * num_envs for n in ("spaced", "torch_spaced")}

    def draw(self, env: int) -> np.float32:
        return np.float32(self.stream.uniform(where=np.arange(self.num_envs) == env)[env])

    def steps(self, env: int, bounds: tuple[float, float]) -> int:
        low, high = map(np.float32, bounds)
        time = low + (high - low) * self.draw(env)
        return max(1, int(np.ceil(time / np.float32(DT) - np.float32(1e-3))))

    def note(self, name: str, where: list[int]) -> None:
        for env in where:
            self.runs[name][env] += 1
            self.drawn[name][env] = self.draw(env)

    def call(self, name: str, now: int, where: list[int]) -> None:
        if where:
            self.calls.setdefault(name, []).append((now, where))

    def far_enough(self, name: str, now: int, ended: list[int]) -> list[int]:
        last = self.last[name]
        due = [e for e in ended if last[e] is None or now - last[e] >= MIN_STEPS]
        for env in due:
            last[env] = now
        return due

    def reset(self, now: int, ended: list[int]) -> None:
        self.note("at_reset", ended)
        self.note("spaced", self.far_enough("spaced", now, ended))
        self.call("torch_at_reset", now, ended)
        self.call("torch_spaced", now, self.far_enough("torch_spaced", now, ended))
        self.note("after_torch", ended)
        for clock in self.clocks.values():
            clock[ended] = 0

    def tick(self, name: str, bounds: tuple[float, float]) -> list[int]:
        clock = self.clocks[name]
        for env in range(self.num_envs):
            clock[env] = (clock[env] or self.steps(env, bounds)) - 1
        return np.flatnonzero(clock == 0).tolist()

    def step(self, now: int) -> None:
        everyone = list(range(self.num_envs))
        for name, bounds in (("all", SHORT), ("torch_all", LONG)):
            self.global_clocks[name] = (self.global_clocks[name] or self.steps(0, bounds)) - 1
        self.note("often", self.tick("often", SHORT))
        self.call("torch_often", now, self.tick("torch_often", LONG))
        self.note("all", everyone if self.global_clocks["all"] == 0 else [])
        self.call("torch_all", now, everyone if self.global_clocks["torch_all"] == 0 else [])
        self.note("always", everyone)
        self.call("torch_always", now, everyone)


def test_terms_run_when_and_with_what_a_plain_account_says():
    num_envs, seed, calls = 6, 11, Calls()
    context = manager_context(num_envs, seed=seed)
    context.owner = calls
    manager = EventManager(events(calls), context)
    stages = plan(context, manager.reset_items(), manager.interval_items(), manager.step_items())
    reference, rng = Reference(num_envs, seed), np.random.default_rng(0)
    for now in range(1, STEPS + 1):
        ended = np.ones(num_envs, bool) if now == 1 else rng.random(num_envs) < 0.2
        set_reset(context, ended.tolist())
        context.step.fill_(now)
        calls.now = now
        stages.run()
        reference.reset(now, np.flatnonzero(ended).tolist())
        reference.step(now)
        for name in reference.runs:
            np.testing.assert_array_equal(state(context, f"{name}_runs"), reference.runs[name], f"{name}, step {now}")
            np.testing.assert_array_equal(state(context, f"{name}_drawn"), reference.drawn[name], f"{name}, step {now}")
    assert calls.by_name == reference.calls
    few = {n: len(c) for n, c in reference.calls.items()} | {n: r.min() for n, r in reference.runs.items()}
    assert min(few.values()) > 2, few  # each of them ran, or this says nothing
    assert reference.runs["spaced"].sum() < reference.runs["at_reset"].sum()


def test_the_first_reset_always_counts_and_the_spacing_can_be_changed():
    context = manager_context(2)
    term = noting("rare", mode="reset", min_step_count_between_reset=10)
    stages = plan(context, EventManager({"rare": term}, context).reset_items())

    def reset_at(step: int, mask: list[bool]) -> list[int]:
        set_reset(context, mask)
        context.step.fill_(step)
        stages.run()
        return state(context, "rare_runs").tolist()

    assert reset_at(0, [True, False]) == [1, 0]
    assert reset_at(0, [True, False]) == [1, 0]
    assert reset_at(9, [True, True]) == [1, 1]
    assert reset_at(10, [True, True]) == [2, 1]
    context.parameters["events.rare.min_step_count_between_reset"] = 3
    assert reset_at(12, [True, True]) == [2, 2]
    assert reset_at(13, [True, True]) == [3, 2]


def test_times_between_runs_are_uniform():
    """With 64 environments over 400 steps: the mean and the spread of the times, and that none is out of bounds."""
    num_envs, steps, low, high = 64, 400, 3, 12
    context = manager_context(num_envs)
    bounds = ((low - 0.999) * DT, high * DT)
    term = noting("push", mode="interval", interval_range_s=bounds)
    stages = plan(context, EventManager({"push": term}, context).interval_items())
    ran = np.zeros((steps, num_envs), bool)
    before = np.zeros(num_envs, int)
    for k in range(steps):
        stages.run()
        runs = state(context, "push_runs").copy()
        ran[k], before = runs > before, runs
    times = np.concatenate([np.diff(np.flatnonzero(ran[:, env])) for env in range(num_envs)])
    assert set(times) == set(range(low, high + 1))
    count, span = len(times), high - low + 1
    assert abs(times.mean() - (low + high) / 2) < 5.0 * np.sqrt((span**2 - 1) / 12 / count)
    counts = np.bincount(times)[low:]
    chi2 = ((counts - count / span) ** 2 / (count / span)).sum()
    assert chi2 < span - 1 + 5.0 * np.sqrt(2.0 * (span - 1))


def history(num_envs: int, global_time: bool, steps: int = 60) -> np.ndarray:
    context = manager_context(num_envs, seed=3)
    term = noting("push", mode="interval", interval_range_s=(0.03, 0.3), is_global_time=global_time)
    manager = EventManager({"push": term}, context)
    stages = plan(context, manager.reset_items(), manager.interval_items())
    set_reset(context, [True] * num_envs)
    runs = []
    for k in range(steps):
        stages.run()
        set_reset(context, [k == 20] * num_envs)
        runs.append(state(context, "push_runs").copy())
    return np.stack(runs)


@pytest.mark.parametrize("global_time", [False, True])
def test_what_environments_draw_does_not_depend_on_their_number(global_time):
    few, many = history(2, global_time), history(8, global_time)
    np.testing.assert_array_equal(few, many[:, :2])
    together = (many == many[:, :1]).all()
    assert together == global_time
    assert few[-1].min() > 3


@pytest.mark.parametrize(("seconds", "steps"), [(0.001, 1), (DT, 1), (3.0 * DT, 3), (0.06, 4), (0.5, 30)])
def test_a_fixed_time_is_counted_in_whole_steps(seconds, steps):
    context = manager_context(1)
    term = noting("push", mode="interval", interval_range_s=(seconds, seconds))
    stages = plan(context, EventManager({"push": term}, context).interval_items())
    runs = []
    for _ in range(3 * steps):
        stages.run()
        runs.append(int(state(context, "push_runs")[0]))
    assert runs == [(k + 1) // steps for k in range(3 * steps)]


def test_the_bounds_may_be_changed_while_it_runs():
    context = manager_context(1)
    term = noting("push", mode="interval", interval_range_s=(4.0 * DT, 4.0 * DT))
    stages = plan(context, EventManager({"push": term}, context).interval_items())

    def after(steps: int) -> int:
        for _ in range(steps):
            stages.run()
        return int(state(context, "push_runs")[0])

    assert after(4) == 1
    context.parameters["events.push.interval_range_s"] = (DT, DT)
    assert after(5) == 6


def test_resets_restart_clocks_but_the_global_one():
    context = manager_context(3)
    fixed = {"mode": "interval", "interval_range_s": (5.0 * DT, 5.0 * DT)}
    terms = {"own": noting("own", **fixed), "all": noting("all", is_global_time=True, **fixed)}
    manager = EventManager(terms, context)
    stages = plan(context, manager.reset_items(), manager.interval_items())
    for step in range(1, 8):
        set_reset(context, [step == 1, step == 3, False])
        stages.run()
        if step == 5:
            assert state(context, "own_runs").tolist() == [1, 0, 1]
            assert state(context, "all_runs").tolist() == [1, 1, 1]
    assert state(context, "own_runs").tolist() == [1, 1, 1]


def test_moved_is_set_where_a_term_ran():
    calls = Calls()
    context = manager_context(4)
    context.owner = calls
    fixed = {"mode": "interval", "interval_range_s": (3.0 * DT, 3.0 * DT)}
    for term in (noting("push", **fixed), calls.term("push", **fixed)):
        manager = EventManager({"push": term}, context)
        wp.to_torch(context.array("events.push.steps_left", int)).zero_()
        stages = plan(context, manager.reset_items(), manager.interval_items())
        for step in range(1, 4):
            set_reset(context, [False, step == 2, False, False])
            context.moved.zero_()
            stages.run()
            assert context.moved.numpy().tolist() == ([True, False, True, True] if step == 3 else [False] * 4)
    for term in (noting("always", mode="step"), calls.term("always", mode="step")):
        context.moved.zero_()
        run(context, EventManager({"always": term}, context).step_items())
        assert context.moved.numpy().all()


def test_startup_runs_everywhere_in_order():
    calls = Calls()
    context = manager_context(3)
    context.owner = calls
    terms = {
        "first": noting("first", mode="startup"),
        "second": calls.term("second", mode="startup"),
        "other": noting("other", mode="reset"),
        "third": noting("third", mode="startup"),
    }
    manager = EventManager(terms, context)
    items = manager.startup_items()
    assert [list(i.terms) for i in items] == [["first"], ["second"], ["third"]]
    run(context, items)
    assert state(context, "first_runs").tolist() == [1, 1, 1]
    assert calls.by_name["second"] == [(0, [0, 1, 2])]
    assert "state.other_runs" not in context.arrays


def test_prestartup_terms_run_without_a_model():
    calls = Calls()
    terms = {
        "early": calls.term("early", mode="prestartup"),
        "late": calls.term("late", mode="startup"),
        "wrong": noting("wrong", mode="prestartup"),
        "none": None,
    }
    items = prestartup_events(terms, calls)
    assert [type(i) for i in items] == [HostFunction]
    items[0].function()
    assert calls.by_name == {"early": [(0, None)], "late": []}

    @configclass
    class EventsCfg:
        early: EventTermCfg = terms["early"]

    assert len(prestartup_events(EventsCfg(), calls)) == 1
    assert prestartup_events(None, calls) == []


def test_neighbouring_warp_terms_share_a_section_and_the_order_is_kept():
    context, calls = manager_context(1), Calls()
    names = [list(i.terms) for i in EventManager(events(calls), context).reset_items()]
    assert names == [
        ["at_reset", "spaced"],
        ["torch_at_reset"],
        ["torch_spaced"],
        ["torch_spaced"],
        ["after_torch"],
        [],
    ]
    eager = [i for i in EventManager(events(calls), context).interval_items() if isinstance(i, HostFunction)]
    assert [i.reason for i in eager] == ["torch term 'torch_often'", "torch term 'torch_all'"]


def test_a_term_about_a_robot_writes_where_it_should():
    context = manager_context(3)
    joints = context.entity("robot").data.joint_names
    legs = SceneEntityCfg("robot", joint_names=[joints[1], joints[3]])
    term = EventTermCfg(func=stretch, params={"asset_cfg": legs, "pos": 0.25}, mode="reset")
    before = context.entity("robot").data.joint_pos.clone()
    set_reset(context, [False, True, False])
    run(context, EventManager({"stretch": term}, context).reset_items())
    expected = before.clone()
    expected[1, [1, 3]] = 0.25
    assert torch.equal(context.entity("robot").data.joint_pos, expected)
    assert context.parameters["events.stretch.pos"] == 0.25


BOX = RigidObjectCfg(
    prim_path="{ENV_REGEX_NS}/Box",
    spawn=CuboidCfg(size=(0.2, 0.2, 0.2), rigid_props=RigidBodyPropertiesCfg(), mass_props=MassPropertiesCfg(mass=1.0)),
    init_state=RigidObjectCfg.InitialStateCfg(pos=(1.0, 0.0, 2.0)),
)


@pytest.mark.parametrize("everything", [True, False])
def test_the_scene_is_reset_as_a_whole_or_one_asset(everything):
    context = manager_context(3, objects={"box": BOX})
    robot, box = context.entity("robot").data, context.entity("box").data
    fresh = [robot.root_state_w.clone(), robot.joint_pos.clone(), box.root_state_w.clone()]
    robot.root_pose_w.add_(0.5)
    robot.joint_pos.add_(0.1)
    robot.joint_pos_target.fill_(0.7)
    box.root_pose_w.add_(0.5)
    params = {} if everything else {"asset_cfg": SceneEntityCfg("box")}
    term = EventTermCfg(func=mdp.reset_scene_to_default, params=params, mode="reset")
    set_reset(context, [True, False, True])
    run(context, EventManager({"everything": term}, context).reset_items())
    torch.testing.assert_close(box.root_state_w[[0, 2]], fresh[2][[0, 2]])
    assert not torch.allclose(box.root_state_w[1], fresh[2][1])
    same = torch.isclose(robot.joint_pos, fresh[1]).all(dim=1)
    assert same.tolist() == [everything, False, everything]
    assert torch.isclose(robot.root_state_w, fresh[0]).all(dim=1).tolist() == [everything, False, everything]
    at_default = torch.isclose(robot.joint_pos_target, robot.default_joint_pos).all(dim=1)
    assert at_default.tolist() == [everything, False, everything]


# -- what is wrong is said


def test_all_problems_are_gathered():
    context = manager_context(1)
    terms = {
        "often": noting("often", mode="sometimes"),
        "when": EventTermCfg(func=note),
        "interval": noting("interval", mode="interval"),
        "backwards": noting("backwards", mode="interval", interval_range_s=(2.0, 1.0)),
        "spaced": noting("spaced", mode="reset", min_step_count_between_reset=-1),
        "early": noting("early", mode="prestartup"),
        "nothing": EventTermCfg(mode="reset"),
        "other": 3,
        "off": None,
        "good": noting("good", mode="reset"),
        "lacking": EventTermCfg(func=stretch, mode="reset"),
        "extra": EventTermCfg(func=stretch, mode="step", params={"pos": 1.0, "poss": 2.0}),
    }
    manager = EventManager(terms, context)
    assert manager.active_terms == ["good", "lacking", "extra"]
    for items in (manager.startup_items, manager.reset_items, manager.interval_items, manager.step_items):
        items()
    text = "\n".join(context.problems)
    for part in (
        "events.often.mode: is 'sometimes', must be one of prestartup, startup, reset, interval, step",
        "events.when.mode: is missing",
        "events.interval.interval_range_s: is None, must be finite (low, high) with 0 <= low <= high, not both 0 [s]",
        "events.backwards.interval_range_s: is (2.0, 1.0)",
        "events.spaced.min_step_count_between_reset: is -1, must be a whole number of steps, 0 or more",
        "events.early.func: is a Warp function; before the model is built only torch functions",
        "events.nothing.func: is missing",
        "events.other: is int, must be EventTermCfg or None",
        "events.lacking.params.pos: is missing",
        "events.extra.params.poss: 'stretch' has no such argument; did you mean 'pos'?",
    ):
        assert part in text, part
    assert len(context.problems) == 10


def test_the_table_says_when_terms_run():
    lines = [" ".join(line.split()) for line in str(EventManager(events(Calls()), manager_context(1))).splitlines()]
    assert "often interval every 0.02 to 0.15 s Warp" in lines
    assert "torch_all interval every 0.05 to 0.2 s, one clock for all torch" in lines
    assert "spaced reset after 7 steps at the earliest Warp" in lines
    assert "always step Warp" in lines


def test_torch_events_get_their_joints_as_indices():
    context = manager_context(num_envs=2, robot="cartpole")
    seen = []
    term = EventTermCfg(
        func=lambda env, env_ids, asset_cfg: seen.append((env_ids.tolist(), asset_cfg.joint_ids)),
        mode="reset",
        params={"asset_cfg": SceneEntityCfg("robot", joint_names=context.entity("robot").data.joint_names[1])},
    )
    manager = EventManager({"mine": term}, context)
    set_reset(context, [False, True])
    run(context, manager.reset_items())
    assert seen == [([1], [1])]


def test_a_class_of_another_kind_is_no_term():
    context = manager_context(num_envs=2, robot="cartpole")
    EventManager({"mine": EventTermCfg(func=dict, mode="reset")}, context)
    assert context.problems == [
        "events.mine.func: is the class 'dict', must be a function, or a class derived from ManagerTermBase"
    ]
