# SPDX-License-Identifier: Apache-2.0
"""Spaces of direct environments that are not those of their hooks: one error that names the field."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_tasks.cartpole.camera import CartpoleCameraEnvCfg
from stripe_tasks.cartpole.direct import CartpoleEnvCfg
from stripe_tasks.locomotion.direct import AntEnvCfg
from tests.helpers.cart_env import CartCfg, CartEnv


class ThreeWaysTo(CartEnv):
    """A cart whose hooks take one action."""

    def _apply_action(self):
        self.robot.set_joint_effort_target(self.actions, joint_ids=[0])


@pytest.mark.parametrize("space", [7, [3, 2], (1, 2, 3)], ids=str)
def test_hooks_that_fail_with_other_actions_are_told_of_as_the_field(space):
    env = ThreeWaysTo(CartCfg(action_space=space))
    env.reset()
    with pytest.raises(ConfigError, match=r"action_space: is .*, must be 1 for ThreeWaysTo: its hooks fail otherwise"):
        env.step(torch.zeros(env.action_space.shape or (env.num_envs,)))


def test_other_errors_of_hooks_stay_as_they_are():
    class Broken(ThreeWaysTo):
        def _get_rewards(self):
            return torch.zeros(3) + torch.zeros(2)

    env = Broken(CartCfg())
    env.reset()
    with pytest.raises(RuntimeError, match="size of tensor a"):
        env.step(torch.zeros(env.num_envs, 1))


@pytest.mark.parametrize("name", ["action_space", "observation_space"])
@pytest.mark.parametrize("cls", [AntEnvCfg, CartpoleEnvCfg])
def test_spaces_that_kernels_are_written_for_are_checked_in_the_config(cls, name):
    own = getattr(cls(), name)
    with pytest.raises(ConfigError, match=f"{name}: is {own + 1}, must be {own}, which the hooks"):
        cls(**{name: own + 1}).validate()
    cls(**{name: own}).validate()


def test_a_camera_of_another_size_has_another_space():
    cfg = CartpoleCameraEnvCfg(observation_space=[32, 32, 3])
    cfg.tiled_camera.width = cfg.tiled_camera.height = 32
    cfg.validate()
    with pytest.raises(ConfigError, match="action_space: is 2, must be 1"):
        CartpoleCameraEnvCfg(action_space=2).validate()
