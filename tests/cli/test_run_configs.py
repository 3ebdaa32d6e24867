# SPDX-License-Identifier: Apache-2.0
"""Configs of a saved run: values of wrong types, also of fields that the command replaces."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stripe_newton.cli.run_configs import load_configs
from stripe_newton.configclass import ConfigError

TASK = "Stripe-Cartpole-Direct-v0"


def run_with(device: object) -> Any:
    params = {"env": {"sim": {"device": device}}, "agent": {}}
    return SimpleNamespace(path="run", read_task=lambda: TASK, read_params=lambda: params)


@pytest.mark.parametrize("device", [-1, ["cpu"]], ids=str)
def test_a_device_that_is_no_name_is_an_error_though_another_one_is_taken(device):
    with pytest.raises(ConfigError, match=r"env\.sim\.device: is .*, must be"):
        load_configs(TASK, run_with(device))


def test_a_group_in_the_place_of_a_device_is_told_of(capsys):
    load_configs(TASK, run_with({1: 2}))
    assert "env.sim.device: was {1: 2}, is None" in capsys.readouterr().err


def test_the_device_of_a_run_is_left_out():
    own = load_configs(TASK, None).env.sim.device
    assert load_configs(TASK, run_with("cuda:7")).env.sim.device == own
    assert load_configs(TASK, run_with("cuda:7"), same_device=True).env.sim.device == "cuda:7"
