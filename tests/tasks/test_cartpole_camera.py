# SPDX-License-Identifier: Apache-2.0
"""Cart-pole by camera: what its picture shows, and what the policy is given of it."""

from __future__ import annotations

import gymnasium
import pytest
import torch

import stripe_tasks  # noqa: F401
from tests.helpers.small_tasks import small_cfg

TASK = "Stripe-Cartpole-Camera-Direct-v0"
N = 3


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make_vec(TASK, cfg=small_cfg(TASK, N))
    yield made
    made.close()


def put(env, cart: list[float], pole: list[float]) -> torch.Tensor:
    """Pictures of carts and poles that are put somewhere, uint8, (N, 64, 64, 3)."""
    joints = torch.zeros(N, 2)
    joints[:, env._cart], joints[:, env._pole] = torch.tensor(cart), torch.tensor(pole)
    env.robot.write_joint_state_to_sim(joints, torch.zeros(N, 2))
    env.sim.forward()
    env.step(torch.zeros(N, 1))
    return env.camera.data.output["rgb"].clone()


def middle(picture: torch.Tensor, background: torch.Tensor) -> torch.Tensor:
    """Column of the middle of what differs from the background, in pixels."""
    differs = ((picture.int() - background.int()).abs().sum(dim=-1) > 40).float()
    columns = torch.arange(differs.shape[1], dtype=torch.float32)
    return (differs.sum(dim=0) * columns).sum() / differs.sum()


def test_observation_is_the_picture_less_its_mean(env):
    obs, _ = env.reset(seed=0)
    colours = env.camera.data.output["rgb"].permute(0, 3, 1, 2) / 255.0
    assert obs["policy"].shape == (N, 3, 64, 64) == (N, *env.single_observation_space["policy"].shape)
    torch.testing.assert_close(obs["policy"], colours - colours.mean(dim=(2, 3), keepdim=True))
    assert obs["policy"].std() > 0.02


def test_the_critic_knows_what_a_picture_does_not_show(env):
    env.reset(seed=0)
    obs, *_ = env.step(torch.ones(N, 1))
    data, cart, pole = env.robot.data, env._cart, env._pole
    state = [data.joint_pos[:, pole], data.joint_vel[:, pole], data.joint_pos[:, cart], data.joint_vel[:, cart]]
    torch.testing.assert_close(obs["critic"], torch.stack(state, dim=1))
    assert obs["critic"][:, 3].abs().min() > 0.01


def test_the_picture_shows_where_the_cart_is_and_how_the_pole_leans(env):
    env.reset(seed=0)
    centred = put(env, [0.0, 1.0, -1.0], [0.0, 0.0, 0.0])
    still = centred.float().median(dim=0).values.to(torch.uint8)
    assert (centred[1] != centred[0]).any()
    left, right = sorted(float(middle(centred[k], still)) for k in (1, 2))
    assert right - left > 6.0, "a cart at each side"
    leaning = put(env, [0.0, 0.0, 0.0], [0.0, 0.5, -0.5])
    assert (leaning[1].int() - leaning[2].int()).abs().sum() > 2000
