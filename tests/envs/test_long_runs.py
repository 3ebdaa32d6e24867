# SPDX-License-Identifier: Apache-2.0
"""Long runs: counters and times after years of steps do what they do at the start."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.sensors import contact
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.envs import RLEnv

TASK = "Stripe-Velocity-Flat-Quadruped-v0"
LATE = 10**10
"""Steps: six years of 20 ms."""


@pytest.fixture(scope="module")
def env():
    """Robots with commands, pushes, contact times and a reset term that waits, in episodes that last for years."""
    cfg = load_cfg(TASK, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed, cfg.episode_length_s = 2, "cpu", 3, 1.0e9
    cfg.events.reset_robot_joints.min_step_count_between_reset = 25
    cfg.events.push_robot.interval_range_s = (0.3, 0.5)
    cfg.commands.base_velocity.resampling_time_range = (0.4, 0.4)
    env = make_env(TASK, cfg).unwrapped
    env.reset(seed=3)
    yield env
    env.close()


def steps(env: RLEnv, count: int) -> list[torch.Tensor]:
    """What steps return, with resets of one environment between them."""
    found: list[torch.Tensor] = []
    generator = torch.Generator().manual_seed(0)
    for number in range(count):
        if number % 20 == 10:
            env.reset(options={"reset_mask": torch.tensor([True, False])})
        observations, *rest, _ = env.step(0.4 * torch.rand(env.action_space.shape, generator=generator) - 0.2)
        found += [value.clone() for value in (*observations.values(), *rest)]
    return found


def test_steps_after_years_are_those_of_the_first_minute(env):
    steps(env, 5)
    state = env.get_state()
    early = steps(env, 80)
    counters = [value for name, value in state["arrays"].items() if name.endswith((".last_run", "context.step"))]
    assert len(counters) == 2
    for counter in counters:
        counter += LATE
    env.set_state(state)
    env.common_step_counter += LATE
    env.episode_length_buf += LATE
    late = steps(env, 80)
    assert all(map(torch.equal, early, late))
    assert env.common_step_counter == LATE + 85
    # One was reset; the other goes on, as no length of an episode of int32 would let it.
    assert env.max_episode_length > 2**31
    assert env.episode_length_buf.tolist() == [10, LATE + 85]


@wp.kernel
def pass_time(count: int, elapsed: float, remainder: wp.array2d[float], sensor: contact.ContactSensorData):
    for _ in range(count):
        times = contact._read_times(0, 0, remainder, sensor)
        contact._update_times(0, 0, sensor.net_forces_w[0, 0], times, elapsed, remainder, sensor)


@pytest.mark.parametrize("touches", [True, False])
def test_times_in_contact_and_in_the_air_do_not_drift(touches):
    """A plain float32 sum of 20 ms is 1.7 % wrong after 8 hours, and stops growing at 524,288 s."""
    elapsed, count = 0.02, 40_000_000
    sensor = contact.ContactSensorData()
    sensor.force_threshold = 1.0
    sensor.net_forces_w = wp.array([[[0.0, 0.0, 5.0 if touches else 0.0]]], dtype=wp.vec3, device="cpu")
    names = ["current_contact_time", "last_contact_time", "current_air_time", "last_air_time"]
    for name in names:
        setattr(sensor, name, wp.zeros((1, 1), dtype=float, device="cpu"))
    remainder = wp.zeros((1, 1), dtype=float, device="cpu")

    def run(number: int) -> list[float]:
        wp.launch(pass_time, 1, inputs=[number, elapsed, remainder, sensor], device="cpu")
        found = [float(getattr(sensor, name).numpy()[0, 0]) for name in names]
        return found if touches else found[2:] + found[:2]

    step = float(np.float32(elapsed))
    for passed in (500_000, count):
        time, *others = run(passed)
        assert others == [0.0, 0.0, 0.0]
        total = step * (passed if passed < count else 500_000 + count)
        assert abs(time - total) <= np.spacing(np.float32(total))
    # After a year: the other state begins from zero, and the last time is that of all of it.
    wp.to_torch(sensor.current_contact_time if touches else sensor.current_air_time)[:] = 3.2e7
    sensor.net_forces_w.assign([[[0.0, 0.0, 0.0 if touches else 5.0]]])
    now, last, other, _ = run(3)
    assert (now, last) == (0.0, np.float32(3.2e7))
    assert other == np.float32(0.06)
