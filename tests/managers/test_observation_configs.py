# SPDX-License-Identifier: Apache-2.0
"""Configs of observations: what is wrong with them, and what is said of it."""

from __future__ import annotations

from typing import Any

import pytest
import torch
import warp as wp

from stripe_newton.configclass import ConfigError
from stripe_newton.envs import mdp
from stripe_newton.managers import (
    IntegratorCfg,
    ModifierCfg,
    ObservationManager,
    RewardTermCfg,
    RunningNormCfg,
    SceneEntityCfg,
)
from stripe_newton.managers import ObservationTermCfg as Term
from stripe_newton.noise import (
    ConstantNoiseCfg,
    GaussianNoiseCfg,
    NoiseCfg,
    NoiseModelCfg,
    NoiseModelWithAdditiveBiasCfg,
    UniformNoiseCfg,
)
from tests.helpers.manager_world import manager_context
from tests.helpers.manager_world import observation_group as group
from tests.helpers.observation_terms import ALL_LEGS, Whole, first_joint, joints, moment, torch_squares


def torch_of_one_env(env: Any, asset_cfg: SceneEntityCfg) -> torch.Tensor:
    return torch_squares(env, asset_cfg)[0]


def torch_number(env: Any) -> float:
    return 1.0


def torch_fails(env: Any) -> torch.Tensor:
    return {}["no_such"]


@wp.func
def squared(env: int, value: float, offset: float) -> float:
    return value * value + offset


@wp.func
def positive(env: int, value: float) -> bool:
    return value > 0.0


BIAS = NoiseModelWithAdditiveBiasCfg(noise_cfg=GaussianNoiseCfg(std=0.1), bias_noise_cfg=UniformNoiseCfg())
LEG = joints("front_left_leg")


@pytest.mark.parametrize(
    ("term", "start", "parts"),
    [
        (Term(mdp.joint_pos, {"asset_cg": SceneEntityCfg()}), "observations.policy.t.params.asset_cg", ["joint_ids"]),
        (Term(moment, {"gian": 1.0, "gain": 2.0}, size=2), "observations.policy.t.params.gian", ["mean 'gain'"]),
        (Term(moment, size=9), "observations.policy.t.params.gain", ["missing", "moment"]),
        (Term(mdp.base_pos_z, {"asset_cfg": "arm"}), "observations.policy.t.params.robot", ["'arm'", "has robot"]),
        (Term(mdp.joint_pos, joints("knee")), "observations.policy.t.params.joint_ids", ["knee", "front_left_leg"]),
        (Term(mdp.base_pos_z, {"asset_cfg": 3}), "observations.policy.t.params.robot", ["3", "SceneEntityCfg"]),
        (Term(mdp.joint_pos, LEG, scale=(1.0, 2.0)), "observations.policy.t.scale", ["2 numbers", "one or 1"]),
        (Term(torch_squares, ALL_LEGS, size=4, scale=[1.0]), "observations.policy.t.scale", ["1 numbers", "or 4"]),
        (Term(first_joint), "observations.policy.t.size", ["None", "the number of values"]),
        (Term(torch_of_one_env, LEG), "observations.policy.t.func", ["(1,)", "(num_envs, size)", "num_envs = 2"]),
        (Term(torch_number), "observations.policy.t.func", ["float", "(num_envs, size)"]),
        (Term(torch_fails), "observations.policy.t.func", ["KeyError", "no_such", "set 'size'"]),
        (Term(first_joint, size=0), "observations.policy.t.size", ["0", "the number of values"]),
        (Term(squared, {"value": 0.0, "offset": 0.0}, size=1), "observations.policy.t.func", ["squared", "out:"]),
        (
            Term(mdp.joint_pos, noise=ConstantNoiseCfg(bias=torch.ones(3))),
            "observations.policy.t.noise.bias",
            ["3 numbers", "one or 8"],
        ),
        (
            Term(mdp.joint_pos, noise=BIAS.replace(bias_noise_cfg=UniformNoiseCfg(n_max=torch.ones(2)))),
            "observations.policy.t.bias_noise.n_max",
            ["2 numbers", "one or 8"],
        ),
        (
            Term(mdp.joint_pos, modifiers=[IntegratorCfg(dt=0.1)], noise=NoiseCfg(func=torch_squares)),
            "observations.policy.t.modifiers.0",
            ["computed by kernels", "torch"],
        ),
        (
            Term(mdp.joint_pos, modifiers=[ModifierCfg(func=dict)]),
            "observations.policy.t.modifiers.0.func",
            ["dict", "ModifierBase"],
        ),
        (
            Term(mdp.joint_pos, modifiers=[ModifierCfg()]),
            "observations.policy.t.modifiers.0.func",
            ["None", "@wp.func"],
        ),
        (
            Term(mdp.joint_pos, modifiers=[IntegratorCfg(dt=0.1), ModifierCfg(func=squared)]),
            "observations.policy.t.modifiers.1.params.offset",
            ["missing", "squared"],
        ),
        (
            Term(mdp.joint_pos, modifiers=[ModifierCfg(func=positive)]),
            "observations.policy.t.modifiers.0.func",
            ["positive", "-> float"],
        ),
        (Term(), "observations.policy.t.func", ["missing"]),
        (Term(NoiseCfg, size=1), "observations.policy.t.func", ["class 'NoiseCfg'", "function"]),
        (RewardTermCfg(mdp.is_alive, 1.0), "observations.policy.t", ["RewardTermCfg", "ObservationTermCfg or None"]),
    ],
)
def test_problems_say_where_and_what_would_be_right(term, start, parts):
    context = manager_context(2)
    context.owner = context
    manager = ObservationManager({"policy": group({"t": term}, enable_corruption=True)}, context)
    manager.compute_items()
    manager.reset_items()
    assert len(context.problems) == 1, context.problems
    assert context.problems[0].startswith(f"{start}:")
    for part in parts:
        assert part in context.problems[0]


def test_problems_of_all_terms_and_groups_are_gathered():
    context = manager_context(2)
    wrong = group({"a": Term(first_joint), "b": Term(mdp.joint_pos), "c": Term(mdp.joint_pos, joints("x"))})
    ObservationManager({"policy": wrong, "critic": {"a": Term(mdp.joint_pos)}, "other": wrong}, context)
    assert [p.partition(":")[0] for p in context.problems] == [
        "observations.critic",
        *(f"observations.{g}.{f}" for g in ("policy", "other") for f in ("a.size", "c.params.joint_ids")),
    ]
    assert "dict, must be ObservationGroupCfg" in context.problems[0]


TERM = Term(mdp.joint_pos)


@pytest.mark.parametrize(
    ("cfg", "problem"),
    [
        (TERM.replace(clip=(1.0, -1.0)), "clip: is (1.0, -1.0), must be (low, high) with low <= high"),
        (TERM.replace(clip=(1.0,)), "clip: is (1.0,), must be 2 numbers (also infinite) or None"),
        (TERM.replace(delay_min_lag=3, delay_max_lag=1), "delay_min_lag: lags are (3, 1), must be 0 <= delay_min_lag"),
        (TERM.replace(delay_min_lag=-1), "delay_min_lag: is -1, must be a whole number of at least 0"),
        (TERM.replace(history_length=-1), "history_length: is -1, must be a whole number of at least 0"),
        (TERM.replace(flatten_history_dim=False), "flatten_history_dim: is False"),
        (TERM.replace(func=Term().func), "func: is missing, ObservationTermCfg needs a value"),
        (TERM.replace(noise=UniformNoiseCfg(n_min=1.0, n_max=0.0)), "noise.n_min: is 1.0, above n_max = 0.0"),
        (TERM.replace(noise=NoiseModelCfg()), "noise.noise_cfg: is missing"),
        (TERM.replace(modifiers=[IntegratorCfg()]), "modifiers.0.dt: is missing"),
    ],
)
def test_config_refuses_numbers_that_make_no_sense(cfg, problem):
    with pytest.raises(ConfigError) as caught:
        Whole(observations={"policy": group({"good": TERM, "t": cfg})}).validate()
    assert len(caught.value.problems) == 1
    assert caught.value.problems[0].startswith(f"observations.policy.t.{problem}")


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"concatenate_dim": 1}, "concatenate_dim: is 1, only the last dimension (-1)"),
        (
            {"concatenate_terms": False, "normalization": RunningNormCfg()},
            "normalization: is set, but concatenate_terms",
        ),
        ({"history_length": -1}, "history_length: is -1"),
        ({"flatten_history_dim": False}, "flatten_history_dim: is"),
    ],
)
def test_group_refuses_what_it_cannot_do(fields, problem):
    with pytest.raises(ConfigError) as caught:
        Whole(observations={"policy": group({"t": TERM}, **fields)}).validate()
    assert len(caught.value.problems) == 1
    assert caught.value.problems[0].startswith(f"observations.policy.{problem}")
