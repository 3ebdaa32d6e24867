# SPDX-License-Identifier: Apache-2.0
"""Curriculum manager: changes, their times and the log, against plain references."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import EpisodeData, Parameter
from stripe_newton.fusion import HostFunction, KernelLaunches, Plan
from stripe_newton.managers import CurriculumManager, CurriculumTermCfg, RewardManager, RewardTermCfg, TermState
from tests.helpers.manager_world import manager_context, plan, set_reset

STEPS = 50


@wp.func
def one(env: int) -> float:
    return 1.0


@wp.func
def raise_level(env: int, episode: EpisodeData, level: wp.array[int], good: float) -> float:
    """Up a level where the episode was long enough, else down to 0 at the least."""
    if float(episode.length[env]) >= good:
        level[env] = level[env] + 1
    else:
        level[env] = wp.max(level[env] - 1, 0)
    return float(level[env])


@wp.func
def halve(step: wp.array[wp.int64], parameter: Parameter, every: int) -> float:
    if step[0] % wp.int64(every) == wp.int64(0):
        parameter.values[parameter.index] = 0.5 * parameter.values[parameter.index]
    return parameter.values[parameter.index]


@wp.func
def wrong_result(env: int) -> int:
    return 1


LEVEL = TermState("level", int)


def logged(context: Any) -> dict[str, float]:
    return dict(zip(context.log.keys, context.log.values.numpy().tolist(), strict=False))


class World:
    """A reward of 1 a step with weight 2, and curriculum terms, stepped as an environment would."""

    def __init__(self, terms: dict[str, Any], num_envs: int = 4, extra: dict[str, float] | None = None):
        self.context = context = manager_context(num_envs)
        context.owner = self
        for path, value in (extra or {}).items():
            context.parameters.add(path, value, float)
        cfg = RewardTermCfg(func=one, weight=2.0)
        self.rewards = RewardManager({"alive": cfg}, context, scale_by_dt=False)
        self.manager = CurriculumManager(terms, context)
        outcome = self.rewards.compute_items()
        per_env, end = self.manager.compute_items(), self.manager.update_items()
        self.items = [*per_env, *end]
        self.stages: Plan | None = None
        if not context.problems:
            self.stages = plan(context, outcome, per_env, [*end, KernelLaunches("log", context.log.finish)])
        self.now = 0

    def step(self, ended: Any = False) -> float:
        """The reward of environment 0 in a step."""
        self.now += 1
        self.context.step.fill_(self.now)
        set_reset(self.context, torch.as_tensor(ended))
        self.stages.run()
        return float(self.context.reward.numpy()[0])


def weight_after(num_steps: int, weight: float = -3.0) -> CurriculumTermCfg:
    params = {"term_name": "alive", "weight": weight, "num_steps": num_steps}
    return CurriculumTermCfg(func=mdp.modify_reward_weight, params=params)


@pytest.mark.parametrize("num_steps", [0, 1, 5])
def test_a_reward_has_the_new_weight_after_that_many_steps(num_steps):
    world = World({"heavier": weight_after(num_steps)})
    for step in range(1, 10):
        assert world.step() == (-3.0 if step > max(num_steps, 1) else 2.0)
        assert logged(world.context)["Curriculum/heavier"] == (-3.0 if step >= num_steps else 2.0)
    assert world.context.parameters["rewards.alive.weight"] == -3.0


def test_changes_follow_each_other_and_can_be_retuned():
    world = World({"first": weight_after(3, 5.0), "second": weight_after(6, 7.0)})
    assert [world.step() for _ in range(8)] == [2.0] * 3 + [5.0] * 3 + [7.0] * 2
    world.context.parameters["curriculum.second.weight"] = 9.0
    assert [world.step() for _ in range(2)] == [7.0, 9.0]


def address(path: str, **params: Any) -> CurriculumTermCfg:
    return CurriculumTermCfg(func=mdp.modify_term_cfg, params={"address": path, **params})


def test_any_parameter_changes_at_once():
    world = World({"later": address("commands.speed.high", value=4.0, num_steps=3)}, extra={"commands.speed.high": 1.0})
    values = []
    for _ in range(5):
        world.step()
        values.append(world.context.parameters["commands.speed.high"])
    assert values == [1.0, 1.0, 4.0, 4.0, 4.0]


@pytest.mark.parametrize(("start", "end"), [(0, 10), (4, 12), (1, 2)])
def test_a_ramp_starts_from_the_value_there_is_and_ends_at_the_other(start, end):
    ramp = address("rewards.alive.weight", value=-1.0, num_steps=end, start_step=start)
    world = World({"ramp": ramp, "halve": CurriculumTermCfg(func=halve, params={"address": "spare", "every": 4})},
                  extra={"spare": 1.0})  # fmt: skip
    world.context.parameters["rewards.alive.weight"] = 6.0
    for step in range(1, 15):
        world.step()
        expected = 6.0 + (-1.0 - 6.0) * np.clip((step - start) / (end - start), 0.0, 1.0)
        assert world.context.parameters["rewards.alive.weight"] == pytest.approx(expected, abs=1e-6)
        assert logged(world.context)["Curriculum/ramp"] == pytest.approx(expected, abs=1e-6)
        assert world.context.parameters["spare"] == 0.5 ** (step // 4)


def test_a_ramp_goes_on_from_a_saved_state():
    terms = {"ramp": address("rewards.alive.weight", value=0.0, num_steps=20, start_step=2)}
    world, other = World(terms), World(terms)
    for _ in range(10):
        world.step()
    for name, array in world.context.arrays.items():
        other.context.arrays[name].assign(array)
    other.now = world.now
    expected = [world.step() for _ in range(12)]
    assert [other.step() for _ in range(12)] == expected
    assert expected[0] == pytest.approx(2.0 * (1.0 - 8.0 / 18.0))


def test_a_parameter_outside_of_terms():
    params = {"address": "terrain.slope", "value": 0.3, "num_steps": 2}
    world = World(
        {"steeper": CurriculumTermCfg(func=mdp.modify_env_param, params=params)}, extra={"terrain.slope": 0.1}
    )
    world.step()
    assert world.context.parameters["terrain.slope"] == pytest.approx(0.1)
    world.step()
    assert world.context.parameters["terrain.slope"] == pytest.approx(0.3)
    assert logged(world.context)["Curriculum/steeper"] == pytest.approx(0.3)


def test_terms_of_environments_against_a_plain_account():
    num_envs, rng = 8, np.random.default_rng(0)
    seen: list[list[int]] = []

    def torch_term(env: Any, env_ids: torch.Tensor, offset: float) -> Any:
        assert isinstance(env, World)
        assert env_ids.dtype is torch.int64
        seen.append(env_ids.tolist())
        return {"first": offset + env_ids[0], "count": len(env_ids)}

    params = {"level": LEVEL, "good": 6.0}
    terms = {
        "level": CurriculumTermCfg(func=raise_level, params=params),
        "torch": CurriculumTermCfg(func=torch_term, params={"offset": 0.5}),
        "silent": CurriculumTermCfg(func=lambda env, env_ids: None),
        "number": CurriculumTermCfg(func=lambda env, env_ids: torch.tensor(2.5) * len(env_ids)),
        "weight": weight_after(10),
        "off": None,
    }
    world = World(terms, num_envs)
    context = world.context
    level, length, expected = np.zeros(num_envs, int), np.zeros(num_envs, int), {}
    calls: list[list[int]] = []
    for step in range(1, STEPS + 1):
        length += 1
        wp.to_torch(context.episode.length)[:] = torch.as_tensor(length)
        ended = rng.random(num_envs) < 0.15
        world.step(ended)
        level = np.where(ended, np.where(length >= 6, level + 1, np.maximum(level - 1, 0)), level)
        length[ended] = 0
        np.testing.assert_array_equal(context.arrays["state.level"].numpy(), level, f"step {step}")
        ids = np.flatnonzero(ended).tolist()
        if ids:
            calls.append(ids)
            expected |= {"level": level[ended].mean(), "torch/first": 0.5 + ids[0], "torch/count": len(ids)}
            expected["number"] = 2.5 * len(ids)
        expected["weight"] = -3.0 if step >= 10 else 2.0
        for key, value in expected.items():
            assert logged(context)[f"Curriculum/{key}"] == pytest.approx(value), f"{key}, step {step}"
    assert seen == calls
    assert len(calls) < STEPS
    assert not any("silent" in key for key in context.log.keys)
    assert level.max() > 2


def test_only_torch_terms_are_eager():
    world = World({"level": CurriculumTermCfg(func=raise_level, params={"level": LEVEL, "good": 1.0}),
                   "weight": weight_after(3), "torch": CurriculumTermCfg(func=lambda env, env_ids: 1.0)})  # fmt: skip
    assert [(i.name, list(i.terms)) for i in world.items] == [
        ("curriculum", ["level"]), ("curriculum", ["torch"]), ("curriculum", ["weight"]),
    ]  # fmt: skip
    assert [i.reason for i in world.items if isinstance(i, HostFunction)] == ["torch term 'torch'"]
    text = [" ".join(line.split()) for line in str(world.manager).splitlines()]
    assert text[-3:] == [
        "level Warp where an episode ends",
        "weight Warp in every step",
        "torch torch when episodes end",
    ]


def test_nothing_is_nothing():
    world = World({})
    assert world.items == []
    assert CurriculumManager(None, world.context).active_terms == []


def test_all_problems_are_gathered():
    terms = {
        "typo": weight_after(3).replace(params={"term_name": "alife", "weight": 1.0, "num_steps": 1}),
        "nowhere": address("observations.height.scale", value=1.0, num_steps=1),
        "unnamed": CurriculumTermCfg(func=mdp.modify_term_cfg, params={"value": 1.0, "num_steps": 1}),
        "lacking": address("rewards.alive.weight", value=1.0),
        "extra": address("rewards.alive.weight", value=1.0, num_steps=1, start=3),
        "result": CurriculumTermCfg(func=wrong_result),
        "nothing": CurriculumTermCfg(),
        "other": weight_after,
    }
    problems = World(terms).context.problems
    text = "\n".join(problems)
    for part in (
        "curriculum.typo.params.parameter: no parameter 'rewards.alife.weight'; near it: rewards.alive.weight",
        "curriculum.nowhere.params.parameter: no parameter 'observations.height.scale'",
        "curriculum.unnamed.params.parameter: is missing, name a reward by 'term_name' or any parameter by 'address'",
        "curriculum.lacking.params.num_steps: is missing",
        "curriculum.extra.params.start: 'modify_term_cfg' has no such argument; did you mean 'start_step'?",
        "curriculum.result.func: 'wrong_result' returns int, a curriculum must be annotated '-> float'",
        "curriculum.nothing.func: is missing",
        "curriculum.other: is function, must be CurriculumTermCfg or None",
    ):
        assert part in text, part
    assert len(problems) == 8
