# SPDX-License-Identifier: Apache-2.0
"""Step times: of a step and of its physics alone, with seeded actions; the state is restored."""

from __future__ import annotations

import pytest
import torch
import warp as wp

from stripe_newton.envs import measure, step_times
from stripe_newton.envs.measure import benchmark, random_actions
from stripe_newton.envs.step_times import LEAD, Clock, measure_step
from tests.helpers.cart_env import CartEnv, make
from tests.helpers.counting_clock import CountingClock


@pytest.fixture
def count_of(monkeypatch):
    """Measure a step of an environment in calls of one of its functions."""

    def measured(env, owner, name):
        original = getattr(owner, name)

        def counted(*args, **kwargs):
            CountingClock.count += 1
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, counted)
        monkeypatch.setattr(step_times, "Clock", CountingClock)
        return measure_step(env, random_actions(env, LEAD + 6), blocks=3)

    return measured


@pytest.fixture
def env():
    made = make()
    made.reset(seed=1)
    for action in random_actions(made, 4):
        made.step(action)
    yield made
    made.close()


def test_the_physics_alone_takes_as_many_solver_steps_as_the_whole_step(env, count_of):
    times = count_of(env, env.sim.solver, "step")
    # Once for the two physics steps, which the solver takes together.
    assert times.env == times.env_wall == times.physics == times.physics_free == [1.0, 1.0, 1.0]
    assert times.physics_ms == 1.0
    assert times.to_dict()["overhead_ratio"] == 0.0


@pytest.mark.parametrize("hook", ["_get_rewards", "_apply_action", "_get_observations"])
def test_the_physics_alone_runs_nothing_of_the_task(env, count_of, hook):
    times = count_of(env, env, hook)
    assert min(times.env) >= 1.0
    assert max(times.physics) == max(times.physics_free) == 0.0


def test_resets_are_in_the_whole_step_and_not_in_the_physics(env, count_of):
    env.episode_length_buf = torch.tensor([9, 0, 2, 9])  # of 10 steps: two end in the block
    times = count_of(env, env, "_reset_idx")
    assert times.env == [2 / 6] * 3, "the state was not brought back: later blocks have other resets"
    assert max(times.physics) == 0.0


def test_the_physics_alone_does_what_the_whole_step_does(env):
    env.episode_length_buf = torch.tensor([9, 0, 2, 9])
    assert measure_step(env, random_actions(env, LEAD + 8), blocks=1).replay_difference == 0.0


def test_physics_under_other_targets_is_noticed():
    class Changing(CartEnv):
        """Its force changes within a step, which the targets that it leaves do not show."""

        def _apply_action(self):
            self.calls.append("apply")
            self.robot.set_joint_effort_target(30.0 * self.actions * (len(self.calls) % 7), joint_ids=[0])

    env = make(Changing, apply_action="substep")
    env.reset(seed=1)
    assert measure_step(env, random_actions(env, LEAD + 8), blocks=1).replay_difference > 1e-4
    env.close()


def test_the_environment_goes_on_where_it_was(env):
    before = env.get_state()
    rng = torch.get_rng_state()
    measure_step(env, random_actions(env, LEAD + 5), blocks=2)
    after = env.get_state()
    assert before["step"] == after["step"]
    for part in ("arrays", "buffers"):
        for name, value in before[part].items():
            assert torch.equal(value, after[part][name]), name
    assert torch.equal(rng, torch.get_rng_state())


def test_actions_are_seeded_and_real(env):
    actions = random_actions(env, 50, seed=3)
    assert actions.shape == (50, 4, 1)
    assert torch.equal(actions, random_actions(env, 50, seed=3))
    assert not torch.equal(actions, random_actions(env, 50, seed=4))
    assert actions.min() < -0.9
    assert actions.max() > 0.9
    assert actions.abs().max() <= 1.0


def test_discrete_actions_are_refused():
    env = make(action_space={3})
    with pytest.raises(ValueError, match="real actions"):
        random_actions(env, 2)
    env.close()


def test_episodes_are_spread_before_anything_is_timed(monkeypatch):
    seen = {}

    def instead(env, actions, blocks):
        seen["lengths"], seen["blocks"], seen["steps"] = env.episode_length_buf.clone(), blocks, len(actions) - LEAD
        raise KeyboardInterrupt

    monkeypatch.setattr(measure, "measure_step", instead)
    made = make(episode_length_s=1000.0)
    closed = []
    monkeypatch.setattr(made, "close", lambda: closed.append(True))
    with pytest.raises(KeyboardInterrupt):
        benchmark(lambda: made, steps=90, warmup=10)
    assert len(seen["lengths"].unique()) == 4
    assert seen["lengths"].min() > 10
    assert (seen["blocks"], seen["steps"]) == (3, 32)
    assert closed, "an environment that failed is closed too"


@pytest.mark.gpu
def test_marks_see_the_work_of_torch_and_of_warp():
    wp.init()
    clock = Clock("cuda:0")
    clock.hold(1e-3)
    clock.wait()
    start = clock.mark()
    clock.hold(0.1)
    middle = clock.mark()
    count = wp.zeros(1, dtype=float, device="cuda:0")
    wp.launch(_count, dim=1, inputs=[20_000_000, count], device="cuda:0")
    end = clock.mark()
    assert clock.ms(start, middle) > 10.0, "the mark did not wait for torch's stream"
    assert clock.ms(middle, end) > 10.0, "the mark did not wait for Warp's stream"


@wp.kernel(enable_backward=False)
def _count(rounds: int, values: wp.array[float]):
    """A kernel that takes long: its rounds depend on each other."""
    x = values[0]
    for _ in range(rounds):
        x = x * 0.5 + 1.0
    values[0] = x
