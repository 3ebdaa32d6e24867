# SPDX-License-Identifier: Apache-2.0
"""Options that users of Isaac Lab and mjlab type by habit are understood, or explained in one line."""

import re

import pytest

import stripe_tasks  # noqa: F401  (registers the tasks)
from stripe_newton.cli import main
from stripe_newton.cli.foreign_options import _INSTEAD, with_own_options
from stripe_newton.cli.options import OPTIONS
from stripe_newton.cli.tasks import load_cfg


@pytest.mark.parametrize("given", [["--task=A-v0"], ["--task", "A-v0"]])
def test_a_task_by_option_is_the_task(given):
    assert with_own_options("train", [*given, "--headless", "--num_envs", "4"]) == ["A-v0", "--num_envs", "4"]
    assert with_own_options("play", [*given, "--enable_cameras", "--viewer", "video"]) == ["A-v0", "--viewer", "video"]


def test_export_has_a_task_option_of_its_own():
    words = ["alone.pt", "--task", "A-v0"]
    assert with_own_options("export", words) == words


def test_fields_by_hydras_syntax_are_options():
    given = ["A-v0", "env.sim.dt=0.01", "agent.actor.hidden_dims=[64, 32]", "--seed", "3"]
    wanted = ["A-v0", "--env.sim.dt", "0.01", "--agent.actor.hidden_dims", "64", "32", "--seed", "3"]
    assert with_own_options("train", given) == wanted
    for word in ("env.py", "env.usd=", "environment.x=1"):
        assert with_own_options("inspect", [word]) == [word]


def test_a_field_without_the_name_of_its_config_is_one_line(capsys):
    assert main(["train", "Stripe-Cartpole-v0", "--sim.dt", "0.01"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "error: train has no --sim.dt: a field of a config is --env.sim.dt or --agent.sim.dt"


def test_other_options_and_commands_are_left_alone():
    words = ["A-v0", "--env.scene.num-envs", "4", "--seed=3"]
    assert with_own_options("train", words) == words
    assert with_own_options("compare", ["--task", "x"]) == ["--task", "x"]


def test_an_option_of_another_name_is_one_line_that_says_which(capsys):
    for words, part in (
        (["train", "--task", "Stripe-Cartpole-v0", "--video", "--video_length", "200"], "--video-interval K"),
        (["train", "Stripe-Cartpole-v0", "--video_length=200"], "--steps N"),
        (["play", "Stripe-Cartpole-v0", "--checkpoint-file", "model.pt"], "--checkpoint RUN_OR_FILE"),
    ):
        assert main(words) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: {words[0]} has no --")
        assert part in line


@pytest.mark.parametrize("command", _INSTEAD)
def test_the_options_that_are_named_exist_and_no_own_one_is_refused(command):
    own = {f"--{name.replace('_', '-')}" for name in OPTIONS[command].__dataclass_fields__}
    assert not own & set(_INSTEAD[command])
    agent = load_cfg("Stripe-Cartpole-v0", "agent")
    named = {name for text in _INSTEAD[command].values() for name in re.findall(r"--[a-z.-]*[a-z]", text)}
    for name in named - own - {"--viewer", "--steps"}:
        assert hasattr(agent, name.removeprefix("--agent.").replace("-", "_")), name
