# SPDX-License-Identifier: Apache-2.0
"""Class terms: torch terms with a state, actions and commands as classes, and configs that change at run time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.data import ArticulationData, CommandData
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import (
    ActionTerm,
    ActionTermCfg,
    CommandTerm,
    CommandTermCfg,
    CurriculumTermCfg,
    EventTermCfg,
    KernelActionTerm,
    ManagerTermBase,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from tests.helpers.cartpole_manager_env import N, actions_of, config, fields
from tests.helpers.manager_world import observation_group

POLE = {"asset_cfg": SceneEntityCfg("robot", joint_names="cart_to_pole")}
RANGE = (0.04, 0.09)


class Progress(ManagerTermBase):
    """How much less the pole leans than in the step before; counts its resets and calls."""

    def __init__(self, cfg: Any, env: Any):
        super().__init__(cfg, env)
        self.joint_ids = cfg.params["asset_cfg"].joint_ids
        self.last = torch.zeros(self.num_envs, device=self.device)
        self.resets = torch.zeros(self.num_envs, device=self.device)
        self.counts: list[int] = []

    def lean(self) -> torch.Tensor:
        return self._env.scene["robot"].data.joint_pos[:, self.joint_ids[0]].abs()

    def reset(self, env_ids: Any = None) -> None:
        self.resets[env_ids] += 1
        self.last[env_ids] = self.lean()[env_ids]

    def __call__(self, env: Any, asset_cfg: SceneEntityCfg, factor: float = 1.0) -> torch.Tensor:
        self.counts.append(env.common_step_counter)
        before = self.last.clone()
        self.last[:] = self.lean()
        return factor * (before - self.last)


class LeanTwice(ManagerTermBase):
    """Angle of the pole in two columns."""

    def __call__(self, env: Any, asset_cfg: SceneEntityCfg) -> torch.Tensor:
        return env.scene["robot"].data.joint_pos[:, asset_cfg.joint_ids].repeat(1, 2)


class After(ManagerTermBase):
    """True from some number of calls on in the episode."""

    def __init__(self, cfg: Any, env: Any):
        super().__init__(cfg, env)
        self.calls = torch.zeros(self.num_envs, device=self.device)

    def reset(self, env_ids: Any = None) -> None:
        self.calls[env_ids] = 0

    def __call__(self, env: Any, calls: int) -> torch.Tensor:
        self.calls += 1
        return self.calls >= calls + torch.arange(self.num_envs)


class PutPole(ManagerTermBase):
    """Put the pole at an angle that grows from call to call."""

    def __init__(self, cfg: Any, env: Any):
        super().__init__(cfg, env)
        self.angle = torch.tensor(0.0)

    def __call__(self, env: Any, env_ids: torch.Tensor, asset_cfg: SceneEntityCfg) -> None:
        self.angle += 0.01
        angle = self.angle.expand(len(env_ids), 1)
        env.scene["robot"].write_joint_state_to_sim(angle, 0.0 * angle, asset_cfg.joint_ids, env_ids)


class Ends(ManagerTermBase):
    """Number of the episodes that ended so far."""

    total = 0

    def __call__(self, env: Any, env_ids: torch.Tensor) -> float:
        self.total += len(env_ids)
        return float(self.total)


class Servo(ActionTerm):
    """Effort towards a commanded position of the cart, computed before each physics step."""

    def __init__(self, cfg: Any, env: Any):
        super().__init__(cfg, env)
        self._raw = torch.zeros(self.num_envs, 1, device=self.device)
        self.applied = 0

    @property
    def action_dim(self) -> int:
        return 1

    @property
    def raw_actions(self) -> torch.Tensor:
        return self._raw

    @property
    def processed_actions(self) -> torch.Tensor:
        return 3.0 * self._raw

    def process_actions(self, actions: torch.Tensor) -> None:
        self._raw[:] = actions

    def apply_actions(self) -> None:
        self.applied += 1
        error = self.processed_actions - self._asset.data.joint_pos[:, :1]
        self._asset.set_joint_effort_target(20.0 * error, joint_ids=[0])

    def reset(self, env_ids: Any = None) -> None:
        self._raw[env_ids] = 0.0


class Place(CommandTerm):
    """A place for the cart; the metric is the last distance to it."""

    def __init__(self, cfg: Any, env: Any):
        super().__init__(cfg, env)
        self.place = torch.zeros(self.num_envs, 2, device=self.device)
        self.metrics["distance"] = torch.zeros(self.num_envs, device=self.device)
        self.drawn: list[int] = []

    @property
    def command(self) -> torch.Tensor:
        return self.place

    def _resample_command(self, env_ids: Any) -> None:
        self.drawn += list(map(int, env_ids))
        self.place[env_ids, 0] = torch.rand(len(env_ids))

    def _update_command(self) -> None:
        self.place[:, 1] = self.time_left

    def _update_metrics(self) -> None:
        self.metrics["distance"] = (self.place[:, 0] - self._env.scene["robot"].data.joint_pos[:, 0]).abs()


@wp.func
def servo_apply(env: int, processed: wp.array[float], robot: ArticulationData, joint_ids: wp.array[int]):
    robot.joint_effort_target[env, joint_ids[0]] = 20.0 * (processed[0] - robot.joint_pos[env, joint_ids[0]])


@wp.func
def servo_process(env: int, action: wp.array[float], processed: wp.array[float]):
    processed[0] = 3.0 * action[0]


@wp.func
def first_of_place(env: int, command: CommandData) -> float:
    return command.command[env, 0]


@wp.func
def lean(env: int, robot: ArticulationData, joint_ids: wp.array[int], factor: float) -> float:
    return factor * wp.abs(robot.joint_pos[env, joint_ids[0]])


def with_classes(**changes: Any) -> Any:
    cfg = config(N, 40)
    cfg.actions = {"servo": ActionTermCfg(class_type=Servo)}
    cfg.observations = {
        "policy": observation_group({
            "twice": ObservationTermCfg(func=LeanTwice, params=POLE),
            "place": ObservationTermCfg(func=mdp.generated_commands, params={"command_name": "place"}),
        })
    }  # fmt: skip
    cfg.commands = {"place": CommandTermCfg(class_type=Place, resampling_time_range=RANGE)}
    cfg.rewards = {
        "progress": RewardTermCfg(func=Progress, params=POLE, weight=2.0),
        "place": RewardTermCfg(func=first_of_place, weight=1.0),
        "lean": RewardTermCfg(func=lean, params={**POLE, "factor": 1.0}, weight=-1.0),
    }
    cfg.terminations = {"after": TerminationTermCfg(func=After, params={"calls": 8})}
    cfg.events = {**fields(cfg.events), "put": EventTermCfg(func=PutPole, params=POLE, mode="reset")}
    cfg.curriculum = {"ends": CurriculumTermCfg(func=Ends)}
    return cfg.replace(**changes)


@pytest.fixture(scope="module")
def env() -> Iterator[ManagerBasedRLEnv]:
    made = ManagerBasedRLEnv(with_classes())
    yield made
    made.close()


def test_instances_see_resets_and_steps(env):
    cfg = env.cfg.rewards["progress"]
    assert cfg.func is Progress, "the config, which is written to files, keeps the class"
    progress: Progress = env.reward_manager.cfg["progress"].func
    assert isinstance(progress, Progress)
    assert progress.joint_ids == [1]
    env.reset(seed=1)
    progress.resets.zero_()
    env.event_manager.cfg["put"].func.angle.zero_()
    counts, steps = np.zeros(N), env.common_step_counter
    progress.counts.clear()
    for step in range(30):
        before = progress.last.clone()
        obs, _, terminated, _, _ = env.step(actions_of(step))
        counts += terminated.numpy()
        angle = env.scene["robot"].data.joint_pos[:, 1]
        np.testing.assert_array_equal(obs["policy"][:, :2], angle[:, None].repeat(1, 2))
        value = env.reward_manager.step_reward[:, 0]
        alive = ~terminated
        np.testing.assert_allclose(value[alive], 2.0 * (before - angle.abs())[alive], atol=1e-6)
        # Where an episode began, the reset came after the event that put the pole.
        np.testing.assert_allclose(progress.last[terminated], angle[terminated].abs(), atol=1e-7)
        assert terminated.tolist() == [(step + 1) % (8 + i) == 0 for i in range(N)]
    np.testing.assert_array_equal(progress.resets, counts)
    assert progress.counts == list(range(steps + 1, steps + 31)), "terms see the count that includes the step"
    assert env.curriculum_manager.cfg["ends"].func.total == counts.sum()


def test_a_command_class_is_drawn_logged_and_read_by_warp_terms(env):
    place = env.command_manager.get_term("place")
    assert isinstance(place, Place)
    place.drawn.clear()
    env.reset(seed=2)
    assert sorted(place.drawn) == list(range(N))
    changed, logs = 0, []
    for step in range(20):
        before, clock = place.place[:, 0].clone(), place.time_left.clone()
        distance = place.metrics["distance"].clone()
        obs, _, terminated, _, extras = env.step(actions_of(step))
        np.testing.assert_array_equal(obs["policy"][:, 2:], env.command_manager.get_command("place"))
        np.testing.assert_allclose(env.reward_manager.step_reward[:, 1], before, atol=1e-6)
        due = clock - env.step_dt <= 0.0
        same = place.place[:, 0] == before
        assert (same == ~(due | terminated)).all()
        changed += int((~same).sum())
        if terminated.any():
            logs.append((float(extras["log"]["Metrics/place/distance"]), float(distance[terminated].mean())))
    assert changed > N
    for logged, expected in logs:
        assert logged == pytest.approx(expected, abs=1e-6)


def test_an_action_class_moves_as_warp_functions_do(env):
    warp = config(N, 40)
    warp.actions = {
        "servo": ActionTermCfg(
            joint_names=["slider_to_cart"], process=servo_process, apply=servo_apply, action_size=1, processed_size=1
        )
    }
    other = ManagerBasedRLEnv(warp)
    own: Servo = env.action_manager.get_term("servo")
    assert env.action_manager.total_action_dim == 1
    for one in (env, other):
        one.reset(seed=0)
        data = one.scene["robot"].data
        data.joint_pos[:], data.joint_vel[:] = torch.tensor([0.1, 0.05]), 0.0
        one.sim.forward()
    own.applied = 0
    for step in range(6):
        env.step(actions_of(step))
        other.step(actions_of(step))
    assert own.applied == 6 * env.cfg.decimation
    moved = [one.scene["robot"].data.joint_pos.numpy() for one in (env, other)]
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-5)
    np.testing.assert_array_equal(env.action_manager.processed_actions, other.action_manager.processed_actions)
    assert "torch action terms: servo" in env.describe()
    # A term of kernels as torch sees it, and one of its own.
    view = other.action_manager.get_term("servo")
    np.testing.assert_array_equal(view.raw_actions, other.action_manager.action)
    alone = KernelActionTerm(warp.actions["servo"], other)
    alone.process_actions(2.0 * torch.ones(N, 1))
    alone.apply_actions()
    data = other.scene["robot"].data
    np.testing.assert_allclose(alone.processed_actions, 6.0)
    np.testing.assert_allclose(data.joint_effort_target[:, 0], 20.0 * (6.0 - data.joint_pos[:, 0]), rtol=1e-6)
    alone.reset([1, 2])
    assert alone.raw_actions[:, 0].tolist() == [2.0, 0.0, 0.0, 2.0]
    assert alone.processed_actions[:, 0].tolist() == [6.0, 0.0, 0.0, 6.0]
    other.close()


def test_states_of_instances_are_saved(env):
    env.reset(seed=3)
    for step in range(5):
        env.step(actions_of(step))
    state = env.get_state()
    runs = []
    for _ in range(2):
        env.set_state(state)
        torch.manual_seed(0)  # the command draws from torch's own generator
        runs.append([env.step(actions_of(step))[:3] for step in range(5, 16)])
    for (obs, reward, ended), (obs_2, reward_2, ended_2) in zip(*runs):
        np.testing.assert_array_equal(ended, ended_2)
        np.testing.assert_allclose(obs["policy"], obs_2["policy"], atol=1e-6)
        np.testing.assert_allclose(reward, reward_2, atol=1e-6)
    assert any(ended.any() for _, _, ended in runs[0])


def test_configs_change_while_the_environment_runs(env):
    manager = env.reward_manager
    env.reset(seed=4)
    env.step(actions_of(0))
    progress, leaning = manager.get_term_cfg("progress"), manager.get_term_cfg("lean")
    progress.weight, progress.params = 0.5, {**progress.params, "factor": 4.0}
    leaning.weight, leaning.params["factor"] = -2.0, 3.0
    manager.set_term_cfg("progress", progress)
    manager.set_term_cfg("lean", leaning)
    before = progress.func.last.clone()
    env.step(actions_of(1))
    now = env.scene["robot"].data.joint_pos[:, 1].abs()
    np.testing.assert_allclose(manager.step_reward[:, 0], 0.5 * 4.0 * (before - now), atol=1e-6)
    np.testing.assert_allclose(manager.step_reward[:, 2], -6.0 * now, atol=1e-6)
    with pytest.raises(KeyError, match="rewards: no term 'leaning'; there is progress, place, lean"):
        manager.get_term_cfg("leaning")
    other = leaning.replace(params={**leaning.params, "asset_cfg": SceneEntityCfg("robot", joint_names=".*")})
    with pytest.raises(ValueError, match=r"rewards\.lean: params\.asset_cfg cannot change"):
        manager.set_term_cfg("lean", other)
    with pytest.raises(ValueError, match=r"rewards\.lean: func cannot change"):
        manager.set_term_cfg("lean", leaning.replace(func=first_of_place))
    ends = env.termination_manager.get_term_cfg("after")
    with pytest.raises(ValueError, match=r"terminations\.after: time_out cannot change"):
        env.termination_manager.set_term_cfg("after", ends.replace(time_out=True))
    env.termination_manager.set_term_cfg("after", ends.replace(params={"calls": -9}))
    assert env.step(actions_of(2))[2].all()
    env.termination_manager.set_term_cfg("after", ends)


class Broken(ManagerTermBase):
    def __init__(self, cfg: Any, env: Any):
        raise ValueError("no such file")


@configclass
class OtherCfg(CommandTermCfg):
    class_type: type | None = dict


def test_what_is_no_term_is_named():
    with pytest.raises(RuntimeError, match=r"rewards\.bad\.func: making 'Broken' raised ValueError: no such file"):
        ManagerBasedRLEnv(with_classes(rewards={"bad": RewardTermCfg(func=Broken, weight=1.0)}))
    wrong = {
        "commands": {"place": OtherCfg(resampling_time_range=RANGE)},
        "actions": {"servo": ActionTermCfg(class_type=Progress)},
        "rewards": {"bad": RewardTermCfg(func=dict, weight=1.0)},
        "observations": {"policy": observation_group({"twice": ObservationTermCfg(func=LeanTwice, params=POLE)})},
    }
    with pytest.raises(ConfigError) as error:
        ManagerBasedRLEnv(with_classes(**wrong))
    text = str(error.value)
    assert "commands.place.class_type: is 'dict', must be derived from CommandTerm" in text
    assert "actions.servo.class_type: is 'Progress', must be derived from ActionTerm" in text
    assert "rewards.bad.func: is the class 'dict', must be a function, or a class derived from ManagerTermBase" in text
