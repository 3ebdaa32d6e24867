# SPDX-License-Identifier: Apache-2.0
"""Wrapper for rsl_rl: new tensors in each step, time-outs, clipped actions."""

from __future__ import annotations

import torch

from tests.helpers.fake_runner import make_env


def test_wrapper_hands_out_new_tensors_and_time_outs():
    env = make_env(num_envs=4)
    first = env.get_observations()
    kept = first["policy"].clone()
    env.episode_length_buf = torch.tensor([29, 29, 0, 0])
    buffer = env.unwrapped.episode_length_buf
    with torch.inference_mode():
        env.unwrapped.x[1, 0] = 5.0  # leaves the line in the step in which the clock runs out
    obs, rewards, dones, extras = env.step(torch.zeros(4, 1))
    torch.testing.assert_close(first["policy"], kept, rtol=0, atol=0)
    assert env.get_observations() is obs
    assert obs["policy"].data_ptr() != first["policy"].data_ptr()
    assert env.unwrapped.episode_length_buf is buffer
    assert dones.tolist() == [1, 1, 0, 0]
    assert extras["time_outs"].tolist() == [True, False, False, False]
    assert rewards.shape == (4,)
    assert "time_outs" not in make_env(is_finite_horizon=True).step(torch.zeros(8, 1))[3]


def test_wrapper_clips_actions():
    free, clipped = make_env(push=(-99.0, 99.0)), make_env(push=(-99.0, 99.0), clip_actions=2.0)
    free.get_observations(), clipped.get_observations()
    two, ten = torch.full((8, 1), 2.0), torch.full((8, 1), 10.0)
    expected = free.step(two)[0]["policy"]
    torch.testing.assert_close(clipped.step(ten)[0]["policy"], expected, rtol=0, atol=0)
    wide = make_env(push=(-99.0, 99.0), clip_actions=2**64)  # torch takes no int of that size
    wide.get_observations()
    torch.testing.assert_close(wide.step(two)[0]["policy"], expected, rtol=0, atol=0)
