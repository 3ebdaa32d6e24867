# SPDX-License-Identifier: Apache-2.0
"""Configs of commands: what is wrong with them, and what is said of it."""

from __future__ import annotations

import pytest
import warp as wp

from stripe_kernels.data import CommandData
from stripe_newton.configclass import ConfigError
from stripe_newton.managers import CommandManager
from stripe_newton.noise import UniformNoiseCfg
from tests.helpers.command_terms import INF, normal_velocity, own, pose, velocity
from tests.helpers.manager_world import manager_context


@wp.func
def no_number(env: int, command: CommandData) -> bool:
    return True


@pytest.mark.parametrize(
    ("term", "start", "parts"),
    [
        (velocity(asset_name="arm"), "commands.t.asset_name", ["'arm'", "robot"]),
        (pose(asset_name="arm"), "commands.t.asset_name", ["'arm'", "robot"]),
        (pose(body_name="hand"), "commands.t.body_name", ["'hand'", "torso", "left_back_foot"]),
        (pose(body_name=".*foot"), "commands.t.body_name", ["more than one", "left_back_foot"]),
        (own(resample=None), "commands.t.resample", ["None", "@wp.func"]),
        (own(update=print), "commands.t.update", ["print", "@wp.func"]),
        (own(metrics={"m": print}), "commands.t.metrics.m", ["print", "@wp.func"]),
        (own(size=0), "commands.t.size", ["0"]),
        (own(params={"scale": 1.0}), "commands.t.params.stride", ["missing", "count_up"]),
        (own(params={"stride": 1.0, "scale": 1.0, "strid": 2.0}), "commands.t.params.strid", ["'stride'"]),
        (own(params={"stride": 1.0}, metrics={"m": no_number}), "commands.t.m.func", ["bool", "-> float"]),
        (UniformNoiseCfg(), "commands.t", ["UniformNoiseCfg", "CommandTermCfg"]),
    ],
)
def test_problems_say_where_and_what_would_be_right(term, start, parts):
    context = manager_context(2)
    manager = CommandManager({"t": term}, context)
    manager.compute_items()
    manager.reset_items()
    assert len(context.problems) == 1, context.problems
    assert context.problems[0].startswith(f"{start}:")
    for part in parts:
        assert part in context.problems[0]


@pytest.mark.parametrize(
    ("cfg", "field"),
    [
        (velocity(resampling_time_range=(0.0, 1.0)), "resampling_time_range"),
        (velocity(resampling_time_range=(2.0, 1.0)), "resampling_time_range"),
        (velocity(rel_standing_envs=1.5), "rel_standing_envs"),
        (velocity(ranges=velocity().ranges.replace(heading=None)), "ranges.heading"),
        (velocity().ranges.replace(lin_vel_x=(1.0, -1.0)), "lin_vel_x"),
        (pose().ranges.replace(yaw=(0.0, INF)), "yaw"),
        (normal_velocity().ranges.replace(zero_prob=(0.0, 0.0, 2.0)), "zero_prob"),
        (normal_velocity().ranges.replace(std_vel=(0.0, -1.0, 0.0)), "std_vel"),
    ],
)
def test_config_refuses_numbers_that_make_no_sense(cfg, field):
    with pytest.raises(ConfigError) as caught:
        cfg.validate()
    assert [line.partition(":")[0] for line in caught.value.problems] == [field]
