# SPDX-License-Identifier: Apache-2.0
"""Config classes of a user's files under the Isaac Lab dialect."""

import pytest

from stripe_newton.configclass import ConfigError
from stripe_newton.isaaclab.configclass import configclass
from stripe_newton.isaaclab.scene import InteractiveSceneCfg
from stripe_newton.isaaclab.term_configs import ActionTermCfg


def test_a_users_config_is_read_as_isaac_lab_reads_it(caplog):
    @configclass
    class Terms:
        weight: int = 1
        kind: ActionTermCfg = None

    class More(Terms):  # without the decorator
        weight = 0.5
        extra = {"a": 1}

    made = More()
    assert (made.weight, made.extra, More().extra is made.extra) == (0.5, {"a": 1}, False)
    assert "class More of" in caplog.text
    made.kind = "no term"  # annotations of a user's class are hints
    made.validate()

    @configclass
    class Scene(InteractiveSceneCfg):
        num_envs: object = 2

    with pytest.raises(ConfigError, match=r"env_spacing: is 'two', must be"):  # those of the package are not
        Scene(num_envs=2, env_spacing="two").validate()


def test_going_through_the_names_of_a_config_finds_its_terms():
    @configclass
    class Rewards:
        alive: ActionTermCfg | None = None
        speed: float = 0.0

    cfg = Rewards()
    cfg.added = 2.0
    assert {n for n in dir(cfg) if not n.startswith("__") and not callable(getattr(cfg, n))} == {
        "alive", "speed", "added",
    }  # fmt: skip
