# SPDX-License-Identifier: Apache-2.0
"""Default reset: what no event resets begins an episode in its default state, unless the config says that it stays."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.envs import LabScene, mdp
from stripe_newton.managers import EventTermCfg, SceneEntityCfg
from tests.helpers.cartpole_manager_env import config, put

N = 3
RANGES = {"position_range": (0.1, 0.2), "velocity_range": (0.0, 0.0)}


def joint_event(*joints: str, func: Any = mdp.reset_joints_by_offset, **fields: Any) -> EventTermCfg:
    entity = SceneEntityCfg("robot", joint_names=list(joints) or None)
    return EventTermCfg(func=func, mode="reset", params={"asset_cfg": entity, **RANGES}, **fields)


def after_a_reset(events: dict[str, EventTermCfg], **changes: Any) -> tuple[torch.Tensor, bool]:
    """Positions of cart and pole after a reset from elsewhere, and whether the default reset takes part."""
    with LabScene(config(N, events=events, **changes)) as lab:
        lab.reset()
        put(lab, pole=[1.0] * N, cart=2.0)
        lab.reset()
        return lab.scene["robot"].data.joint_pos.clone(), "reset_to_default" in lab.describe()


def cart_at_half(env: Any, env_ids: torch.Tensor) -> None:
    env.scene["robot"].data.joint_pos[env_ids, 0] = 0.5


@pytest.mark.parametrize(
    ("events", "cart", "pole", "takes_part"),
    [
        ({}, (0.0, 0.0), (0.0, 0.0), True),
        ({"pole": joint_event("cart_to_pole")}, (0.0, 0.0), (0.1, 0.2), True),
        ({"pole": joint_event("cart_to_pole"), "cart": joint_event("slider_.*")}, (0.1, 0.2), (0.1, 0.2), False),
        ({"all": joint_event()}, (0.1, 0.2), (0.1, 0.2), False),
        ({"all": EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")}, (0.0, 0.0), (0.0, 0.0), False),
        ({"rare": joint_event(min_step_count_between_reset=1000)}, (0.0, 0.0), (0.0, 0.0), True),
        ({"torch": EventTermCfg(func=cart_at_half, mode="reset")}, (0.5, 0.5), (0.0, 0.0), True),
    ],
    ids=["no event", "one joint", "each joint", "all joints", "the scene", "not at every reset", "a torch event"],
)
def test_joints_that_no_event_resets_are_reset(events, cart, pole, takes_part):
    position, has_part = after_a_reset(events)
    for values, (low, high) in zip(position.T, (cart, pole), strict=True):
        assert ((values >= low - 1e-6) & (values <= high + 1e-6)).all()
    assert has_part == takes_part


def test_an_asset_may_stay():
    position, has_part = after_a_reset({"pole": joint_event("cart_to_pole")}, keep_at_reset=["ro.*"])
    assert position[:, 0].tolist() == [2.0] * N
    assert not has_part
    with pytest.raises(ConfigError, match=r"keep_at_reset: asset expression 'robots' matches nothing"):
        LabScene(config(N, keep_at_reset=["robots"]))
