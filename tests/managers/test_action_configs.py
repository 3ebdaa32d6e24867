# SPDX-License-Identifier: Apache-2.0
"""Configs of action terms: what is wrong with them, and what is said of it."""

from __future__ import annotations

from typing import Any

import pytest

from stripe_newton.envs import mdp as cfgs
from stripe_newton.managers import ActionManager, ManagerContext
from stripe_newton.noise import NoiseCfg, UniformNoiseCfg
from tests.helpers.action_world import BASE, INF, LEGS, own_term
from tests.helpers.manager_world import manager_context


def problems(terms: Any) -> list[str]:
    context: ManagerContext = manager_context(2)
    manager = ActionManager(terms, context)
    for items in (manager.process_items, manager.apply_items, manager.reset_items):
        items()
    return context.problems


def legs(**fields: Any) -> Any:
    return cfgs.JointPositionActionCfg(joint_names=LEGS, **fields)


GRIP = {"joint_names": LEGS, "open_command_expr": {".*": 1.0}, "close_command_expr": {".*": 0.0}}


@pytest.mark.parametrize(
    ("term", "start", "parts"),
    [
        (legs().replace(joint_names=["knee_.*"]), "actions.t.joint_names", ["knee_.*", *LEGS]),
        (legs(asset_name="arm"), "actions.t.asset_name", ["'arm'", "robot"]),
        (legs(scale={"knee": 1.0}), "actions.t.scale", ["knee", *LEGS]),
        (legs(scale={"front.*": 1.0, ".*leg": 2.0}), "actions.t.scale", ["front_left_leg", "exclusive"]),
        (legs(offset=(0.0, 1.0)), "actions.t.offset", ["2", "4"]),
        (legs(clip={"knee": (0.0, 1.0)}), "actions.t.clip", ["knee", *LEGS]),
        (
            cfgs.BinaryJointPositionActionCfg(**(GRIP | {"close_command_expr": {"front.*": 0.0}})),
            "actions.t.close_command_expr",
            ["left_back_leg, right_back_leg"],
        ),
        (cfgs.NonHolonomicActionCfg(**(BASE | {"body_name": "cabin"})), "actions.t.body_name", ["cabin", "torso"]),
        (
            cfgs.NonHolonomicActionCfg(**(BASE | {"body_name": ".*leg"})),
            "actions.t.body_name",
            ["more than one body", *LEGS],
        ),
        (cfgs.NonHolonomicActionCfg(**(BASE | {"x_joint_name": "x"})), "actions.t.x_joint_name", ["'x'", *LEGS]),
        (own_term(process=None), "actions.t.process", ["None"]),
        (own_term(apply=None), "actions.t.apply", ["None"]),
        (own_term(process=print), "actions.t.process", ["print", "@wp.func"]),
        (own_term(params={"gain": 1.0, "damping": 0.0, "first": 0.0}), "actions.t.params.weights", ["missing"]),
        (own_term(params=own_term().params | {"dampnig": 1.0}), "actions.t.params.dampnig", ["damping"]),
        (own_term(action_size=0), "actions.t.action_size", ["0"]),
        (legs(noise=NoiseCfg(func=print)), "actions.t.noise", ["UniformNoiseCfg"]),
        (UniformNoiseCfg(), "actions.t", ["UniformNoiseCfg", "ActionTermCfg"]),
    ],
)
def test_problems_say_where_and_what_would_be_right(term, start, parts):
    found = problems({"t": term})
    assert len(found) == 1, found
    assert found[0].startswith(f"{start}:")
    for part in parts:
        assert part in found[0]


def test_problems_of_all_terms_are_gathered():
    found = problems({"a": legs(scale={"x": 1.0}, clip={"y": (0.0, 1.0)}), "b": legs(asset_name="arm")})
    assert [p.partition(":")[0] for p in found] == ["actions.a.scale", "actions.a.clip", "actions.b.asset_name"]


@pytest.mark.parametrize(
    ("cfg", "field"),
    [
        (legs(delay_min_lag=2, delay_max_lag=1), "delay_min_lag"),
        (legs(clip={"a": (1.0, 0.0)}), "clip['a']"),
        (legs(scale=float("nan")), "scale"),
        (legs(kind=""), "kind"),
        (legs(kind="Unknown"), "kind"),
        (cfgs.NonHolonomicActionCfg(**BASE, offset=(0.0, INF)), "offset"),
        (cfgs.EMAJointPositionToLimitsActionCfg(alpha=1.5), "alpha"),
    ],
)
def test_config_refuses_numbers_that_make_no_sense(cfg, field):
    assert [name for name, _ in cfg.problems()] == [field]
