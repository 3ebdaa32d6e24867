# SPDX-License-Identifier: Apache-2.0
"""Substeps: how often a direct environment applies its action."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.envs.substeps import Substeps
from tests.helpers.cart_env import CartEnv, N, make


class SpringEnv(CartEnv):
    """Its effort depends on the state."""

    def _apply_action(self):
        self.calls.append("apply")
        self.robot.set_joint_effort_target(-50.0 * self.joint_pos[:, :1], joint_ids=[0])


class ForcingEnv(CartEnv):
    """Writes the state itself."""

    def _apply_action(self):
        self.calls.append("apply")
        self.robot.write_joint_velocity_to_sim(torch.full((N, 1), 0.5), [0])


@pytest.mark.parametrize(
    ("cls", "mode", "applied"),
    [
        (CartEnv, "auto", 1),
        (SpringEnv, "auto", 2),
        (ForcingEnv, "auto", 2),
        (SpringEnv, "step", 1),
        (CartEnv, "substep", 2),
    ],
)
def test_how_often_the_action_is_applied(cls, mode, applied):
    env = make(cls, apply_action=mode)
    env.reset(seed=1)
    for _ in range(5):
        env.step(torch.ones(N, 1))
    env.calls.clear()
    env.step(torch.ones(N, 1))
    assert env.calls.count("apply") == applied


def test_watching_the_action_does_not_change_the_physics():
    results = []
    for mode in ("auto", "substep", "step"):
        env = make(apply_action=mode)
        env.reset(seed=1)
        for k in range(8):
            env.step(torch.full((N, 1), float(k)))
        results.append(env.joint_pos.clone())
    assert torch.equal(results[0], results[1])
    assert torch.equal(results[0], results[2])


def test_targets_are_watched_ever_more_rarely():
    substeps, watched = Substeps("auto", 2), []
    for step in range(9000):
        if substeps.watches:
            watched.append(step)
        substeps.count_step()
    assert watched == [0, 1, 2, 64, 128, 256, 512, 1024, 2048, 4096, 8192]
    assert not Substeps("step", 2).watches
