# SPDX-License-Identifier: Apache-2.0
"""Between steps: managers compute, process and apply outside of the step, with its results and without a trace."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stripe_newton.envs import LabScene, mdp
from stripe_newton.managers import EventTermCfg, ObservationGroupCfg, ObservationTermCfg, RewardTermCfg
from tests.helpers.cartpole_manager_env import actions_of, config, fields, put, rich

N = 4


def arrays(lab: LabScene) -> dict[str, np.ndarray]:
    return {name: array.numpy().copy() for name, array in lab.context.arrays.items()}


def unchanged(lab: LabScene, before: dict[str, np.ndarray]) -> None:
    for name, value in arrays(lab).items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


@pytest.fixture(scope="module")
def lab():
    """With history, delay, noise, commands and events; delays and histories are those of the policy."""
    cfg = rich()
    cfg.observations["policy"].enable_corruption = False
    made = LabScene(cfg)
    yield made
    made.close()


def test_observations_after_a_step_are_those_of_the_step_with_history_and_delay(lab):
    observations, _ = lab.reset(seed=4)
    for step in range(60):  # episodes of 37 steps
        torch.testing.assert_close(lab.observation_manager.compute()["policy"], observations["policy"], atol=0, rtol=0)
        observations = lab.step(actions_of(step))[0]


def test_an_answer_leaves_no_trace_and_the_next_step_is_the_same(lab):
    results = []
    for asks in (False, True):
        lab.reset(seed=6)
        out = []
        for step in range(45):
            if asks:
                before = arrays(lab)
                lab.compute_observations(), lab.compute_rewards(), lab.compute_terminations()
                lab.reward_manager.compute_terms()
                unchanged(lab, before)
            out.append(torch.cat((lab.step(actions_of(step))[0]["policy"], lab.reward_buf[:, None]), 1))
        results.append(torch.stack(out))
    assert torch.equal(*results)


def test_answers_follow_a_state_that_was_set_by_hand(lab):
    lab.reset()
    put(lab, pole=[0.1, 0.2, 3.0, 0.4], cart=[0.0, 0.5, 0.0, 9.0])
    terminated, truncated = lab.termination_manager.compute()
    assert terminated.tolist() == [False, False, True, True]
    assert not truncated.any()
    index = lab.reward_manager.active_terms.index("pole_pos")
    expected = -torch.tensor([0.1, 0.2, 3.0, 0.4]).square()
    torch.testing.assert_close(lab.reward_manager.compute_terms()[:, index], expected)
    alive = lab.reward_manager.active_terms.index("alive")
    weight = lab.context.parameters["rewards.alive.weight"]
    # The lab scene computes the ends of episodes first, as a step does; the manager alone reads those of the last step.
    difference = lab.reward_manager.compute() - lab.compute_rewards()
    assert lab.reward_manager.compute_terms()[:, alive].tolist() == [weight] * N
    torch.testing.assert_close(difference, torch.tensor([0.0, 0.0, weight + 2.0, weight + 2.0]))


def test_torch_terms_answer_too():
    def cart(env):
        return env.scene["robot"].data.joint_pos[:, :1].clone()

    cfg = config(2)
    cfg.observations = {"policy": ObservationGroupCfg(cart=ObservationTermCfg(func=cart, history_length=2))}
    cfg.rewards = {"cart": RewardTermCfg(func=lambda env: env.scene["robot"].data.joint_pos[:, 0], weight=2.0)}
    with LabScene(cfg) as lab:
        lab.reset()
        put(lab, pole=[0.0, 0.0], cart=[0.5, -0.5])
        torch.testing.assert_close(lab.compute_observations()["policy"], torch.tensor([[0.0, 0.5], [0.0, -0.5]]))
        torch.testing.assert_close(lab.compute_rewards(), torch.tensor([1.0, -1.0]))


def test_groups_that_are_not_concatenated_answer_by_term():
    cfg = config(2)
    cfg.observations = {
        "policy": ObservationGroupCfg(
            concatenate_terms=False,
            joints=ObservationTermCfg(func=mdp.joint_pos),
            speed=ObservationTermCfg(func=mdp.joint_vel),
        )
    }
    with LabScene(cfg) as lab:
        lab.reset()
        answer = lab.compute_observations()["policy"]
        assert {name: tuple(value.shape) for name, value in answer.items()} == {"joints": (2, 2), "speed": (2, 2)}


def test_process_is_that_of_a_step():
    results = []
    for by_hand in (False, True):
        with LabScene(config()) as lab:
            lab.reset(seed=1)
            for step in range(5):
                if by_hand:
                    lab.action_manager.process(actions_of(step))
                    lab.action_manager.apply()
                    lab.sim.step(lab.cfg.decimation)
                else:
                    lab.step(actions_of(step))
            results.append(lab.scene["robot"].data.joint_pos.clone())
            with pytest.raises(ValueError, match=r"actions have shape \(3, 1\), expected \(4, 1\)"):
                lab.action_manager.process(torch.zeros(3, 1))
    assert torch.equal(*results)


def test_events_are_applied_in_chosen_environments(lab):
    lab.reset(seed=2)
    before, length = lab.scene["robot"].data.joint_pos.clone(), lab.episode_length_buf.clone()
    lab.event_manager.apply("reset", [1, 3])
    changed = (lab.scene["robot"].data.joint_pos != before).any(1)
    assert changed.tolist() == [False, True, False, True]
    assert torch.equal(lab.episode_length_buf, length)  # nothing else of a reset happens
    speed = lab.scene["robot"].data.joint_vel.clone()
    lab.event_manager.apply("interval")  # kicks all, whatever their clocks say
    assert (lab.scene["robot"].data.joint_vel[:, 0] != speed[:, 0]).all()
    with pytest.raises(ValueError, match="no term of mode 'startup'; there are reset, interval"):
        lab.event_manager.apply("startup")


def test_torch_events_are_applied_too():
    calls: list[list[int]] = []
    cfg = config(3)
    note = EventTermCfg(lambda env, ids: calls.append(ids.tolist()), mode="interval", interval_range_s=(9.0, 9.0))
    cfg.events = {"note": note}
    with LabScene(cfg) as lab:
        lab.reset()
        lab.event_manager.apply("interval", torch.tensor([2, 0]))
        assert calls[-1] == [0, 2]


def test_dynamics_are_drawn_as_the_events_say():
    cfg = config(3)
    mass = EventTermCfg(
        func=mdp.randomize_rigid_body_mass,
        mode="startup",
        params={"mass_distribution_params": (1.5, 2.0), "operation": "scale"},
    )
    cfg.events = {**fields(cfg.events), "mass": mass}
    with LabScene(cfg) as lab:
        data = lab.scene["robot"].data
        first = data.body_mass.clone()
        lab.controller.randomize_dynamics([1])
        assert torch.equal(data.body_mass[[0, 2]], first[[0, 2]])
        moving = data.default_mass[1] > 0
        ratio = (data.body_mass[1] / data.default_mass[1])[moving]
        assert ((ratio >= 1.5) & (ratio <= 2.0)).all()
        assert not torch.equal(ratio, (first[1] / data.default_mass[1])[moving])


def test_commands_are_sampled_anew_in_chosen_environments(lab):
    lab.reset()
    before = lab.command_manager.get_command("place").clone()
    lab.command_manager.reset([0])
    after = lab.command_manager.get_command("place")
    assert (after[0] != before[0]).all()
    assert torch.equal(after[1:], before[1:])
