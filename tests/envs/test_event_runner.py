# SPDX-License-Identifier: Apache-2.0
"""Event runner: events of direct environments."""

from __future__ import annotations

from typing import Any

import pytest

from stripe_newton.configclass import ConfigError
from stripe_newton.envs.events import EventRunner
from stripe_newton.envs.events import EventTermCfg as FromEnvs
from stripe_newton.managers import EventTermCfg


class FakeEnv:
    scene: dict[str, Any] = {}
    num_envs, device, step_dt, common_step_counter = 3, "cpu", 0.02, 0


def test_there_is_one_config_class():
    assert FromEnvs is EventTermCfg


def test_direct_environments_refuse_what_they_cannot_run():
    terms = {"early": EventTermCfg(func=print, mode="prestartup"), "other": 1}
    with pytest.raises(ConfigError) as caught:
        EventRunner(terms, FakeEnv())
    assert len(caught.value.problems) == 2
    assert "events.other: is int, must be EventTermCfg or None" in str(caught.value)
    assert "events.early.mode: is 'prestartup', in a direct environment it must be one of startup" in str(caught.value)


def test_direct_environments_run_terms_of_every_step_and_count_whole_steps():
    seen: dict[str, list[int]] = {"always": [], "long": []}
    term = {"func": lambda env, ids, key: seen[key].append(len(ids))}
    terms = {
        "always": EventTermCfg(mode="step", params={"key": "always"}, **term),
        "long": EventTermCfg(mode="interval", interval_range_s=(5.0, 5.0), params={"key": "long"}, **term),
    }
    runner = EventRunner(terms, FakeEnv())
    assert runner.has_intervals
    assert all(runner.interval(0.02) for _ in range(249))
    assert seen["long"] == []
    runner.interval(0.02)
    assert seen == {"always": [3] * 250, "long": [3]}
