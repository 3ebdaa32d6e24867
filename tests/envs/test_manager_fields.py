# SPDX-License-Identifier: Apache-2.0
"""Manager fields: what is no config of terms, or is read by no manager, is one clear line before anything is built."""

from __future__ import annotations

import dataclasses

import pytest

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import (
    ObservationGroupCfg,
    ObservationManagerCfg,
    ObservationTermCfg,
    RewardManagerCfg,
    RewardTermCfg,
)
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg

ALIVE = RewardTermCfg(func=mdp.is_alive, weight=1.0)


class Plain:
    alive = ALIVE


@dataclasses.dataclass
class Data:
    alive: RewardTermCfg = dataclasses.field(default_factory=ALIVE.copy)


@configclass
class MistypedCfg(CartpoleManagerEnvCfg):
    reward: object = {"alive": ALIVE}
    friction: float = 0.5
    names: dict[str, str] = {"a": "b"}


@configclass
class StrayCfg(CartpoleManagerEnvCfg):
    energy: object = RewardManagerCfg(alive=ALIVE)


@pytest.mark.parametrize(
    ("cfg", "text"),
    [
        (CartpoleManagerEnvCfg(rewards=Plain()), "rewards: is a Plain, must be a dict of RewardTermCfg by name, or an"),
        (CartpoleManagerEnvCfg(rewards=Data()), "rewards: is a Data, whose class has @dataclass; write @configclass"),
        (
            CartpoleManagerEnvCfg(rewards=RewardManagerCfg),
            "rewards: is the class RewardManagerCfg, must be an instance",
        ),
        (MistypedCfg(), "reward: has terms, and no manager reads a field of that name; did you mean 'rewards'?"),
        (
            StrayCfg(),
            "energy: has terms, and no manager reads a field of that name; terms are read from observations, ",
        ),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, str) else "",
)
def test_a_field_that_no_manager_can_read_is_one_line(cfg, text):
    with pytest.raises(ConfigError) as caught:
        cfg.validate()
    assert len(caught.value.problems) == 1
    assert caught.value.problems[0].startswith(text)


def test_terms_without_a_group_beside_a_group_policy_are_refused():
    term = ObservationTermCfg(func=mdp.joint_pos)
    cfg = ObservationManagerCfg(joint_pos=term, policy=ObservationGroupCfg(joint_pos=term))
    with pytest.raises(ConfigError, match="joint_pos: is a term without a group, and there is a group 'policy'"):
        cfg.validate()
