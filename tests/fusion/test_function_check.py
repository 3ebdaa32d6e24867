# SPDX-License-Identifier: Apache-2.0
"""Function check: what is wrong in a Warp function is a line with its place, before a kernel is compiled."""

from __future__ import annotations

import inspect

import pytest
import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ArticulationData
from stripe_newton.configclass import ConfigError
from stripe_newton.envs import LabScene
from stripe_newton.fusion import function_problem
from stripe_newton.managers import RewardTermCfg
from stripe_newton.sim import Simulation
from tests.helpers.cartpole_manager_env import config


@wp.func
def changing_constant(env: int, robot: ArticulationData) -> float:
    total = 0.0
    for j in range(robot.joint_pos.shape[1]):
        total += robot.joint_pos[env, j]
    return total


@wp.func
def mixed_types(env: int, robot: ArticulationData) -> float:
    return wp.max(1, robot.joint_pos[env, 0])


@wp.func
def unknown_field(env: int, robot: ArticulationData) -> float:
    return robot.joint_position[env, 0]


@wp.func
def unknown_name(env: int, robot: ArticulationData) -> float:
    return clamped(robot.joint_pos[env, 0])  # noqa: F821


@wp.func
def calls_a_wrong_one(env: int, robot: ArticulationData) -> float:
    return 2.0 * mixed_types(env, robot)


@pytest.mark.parametrize(
    ("function", "line", "text"),
    [
        (
            changing_constant,
            3,
            "mutating a constant total inside a dynamic loop. 'total' changes in a loop",
        ),
        (mixed_types, 1, "Input types must be the same, got ['int32', 'float32']. an int meets a float; write 1.0"),
        (
            unknown_field,
            1,
            "`joint_position` is not an attribute of 'robot' (stripe_kernels.data.Arti",
        ),
        (
            unknown_name,
            1,
            "Referencing undefined symbol: clamped. 'clamped' is not known here; import it",
        ),
    ],
    ids=lambda value: getattr(value, "key", None) and value.func.__name__,
)
def test_an_error_is_a_line_with_its_place_and_a_hint(function, line, text):
    first = inspect.getsourcelines(function.func)[1]
    problem = function_problem(function)
    assert problem.startswith(f"{__file__}:{first + 1 + line}: {text}")
    assert "\n" not in problem


def test_an_error_in_a_function_that_is_called_has_the_place_there():
    first = inspect.getsourcelines(mixed_types.func)[1]
    assert function_problem(calls_a_wrong_one).startswith(f"{__file__}:{first + 2}: Input types")


def test_functions_that_compile_have_no_problem():
    functions = [f for f in vars(mdp).values() if isinstance(f, wp.Function)]
    assert len(functions) > 100
    assert not [f.key for f in functions if function_problem(f)]


def test_it_is_found_before_the_model_is_made(monkeypatch):
    monkeypatch.setattr(Simulation, "build", lambda *args, **kwargs: pytest.fail("the model was made"))
    cfg = config(2)
    cfg.rewards = {"bad": RewardTermCfg(mixed_types, weight=1.0)}
    with pytest.raises(ConfigError, match=r"rewards\.bad\.func: 'mixed_types' at .*test_function_check.py:\d+: Input"):
        LabScene(cfg)
