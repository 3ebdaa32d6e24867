# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton demo``: policies that come with tasks fit them and are shown; what is missing is named."""

from __future__ import annotations

import re

import gymnasium
import pytest

import stripe_tasks
from stripe_newton.cli import demo, main
from stripe_newton.cli.options import DemoArgs
from stripe_newton.cli.packaged_policy import packaged_policy, tasks_with_policy
from stripe_newton.cli.tasks import task_ids
from stripe_newton.registration import register_task
from stripe_newton.rl import read_policy_metadata


@pytest.fixture
def tasks():
    """Forget the tasks that a test registers."""
    task_ids()
    before = dict(gymnasium.registry)
    yield
    gymnasium.registry.clear()
    gymnasium.registry.update(before)


@pytest.mark.parametrize("task", stripe_tasks.POLICIES)
def test_policies_of_the_package_are_small_and_of_their_tasks(task):
    file = packaged_policy(task)
    assert file.stat().st_size <= 1_000_000
    metadata = read_policy_metadata(file)
    assert metadata["task"] == task
    # The exporter notes where the code of each operation was, on the machine that exported it.
    assert not re.search(rb"/(home|root|tmp|work)/|site-packages", file.read_bytes())
    assert task in tasks_with_policy()


def test_it_acts_with_the_policy_of_the_task(capsys):
    """The cart-pole's policy keeps the pole up, which random actions do not for two seconds."""
    assert main(["demo", "Stripe-Cartpole-v0", "--viewer", "none", "--steps", "120", "--seed", "3"]) == 0
    assert "0 episodes ended" in capsys.readouterr().out


def test_the_quadruped_walks(capsys):
    """Four seconds of commands, with noise and pushes, without a fall."""
    words = ["demo", "Stripe-Velocity-Flat-Quadruped-v0", "--viewer", "none", "--steps", "200", "--seed", "1"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "0 episodes ended" in out


def test_it_says_how_long_the_start_took_and_opens_the_page(capsys, monkeypatch):
    pytest.importorskip("viser")
    opened = []
    monkeypatch.setattr(demo.webbrowser, "open", opened.append)
    monkeypatch.setenv("DISPLAY", ":0")
    words = ["demo", "Stripe-Cartpole-v0", "--steps", "2", "--num-envs", "1", "--port", "8471"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "ready after" in out
    assert len(opened) == 1
    assert opened[0] in out
    assert main([*words, "--browser", "False"]) == 0
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(words) == 0
    assert len(opened) == 1


def test_the_default_is_a_task_with_a_policy(monkeypatch):
    assert demo._default_task() in tasks_with_policy()
    monkeypatch.setattr(demo, "tasks_with_policy", lambda: ["B-v0", demo._FIRST_CHOICE])
    assert demo._default_task() == demo._FIRST_CHOICE
    monkeypatch.setattr(demo, "tasks_with_policy", list)
    with pytest.raises(Exception, match="no installed task has a policy"):
        demo._default_task()


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (None, "has no policy of its own"),
        ("stripe_tasks:policies/none.onnx", "is not in the package"),
        ("no_such_package:a.onnx", "a package that is not installed"),
    ],
)
def test_a_missing_policy_is_one_error(tasks, capsys, policy, message):
    register_task("Own-v0", env="a:B", env_cfg="a:C", policy=policy)
    assert main(["demo", "Own-v0"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["Stripe-Cartpol-v0"], "did you mean"),
        (["Stripe-Cartpole-v0", "--steps", "0"], "--steps 0"),
        (["Stripe-Cartpole-v0", "--num-envs", "0"], "num_envs"),
        (["Stripe-Cartpole-v0", "--device", "cuda:99"], "--device cuda:99"),
    ],
)
def test_wrong_options_are_one_error(capsys, words, message):
    assert main(["demo", *words]) == 2
    assert message in capsys.readouterr().err


def test_its_options_have_defaults():
    assert DemoArgs().num_envs == 4
