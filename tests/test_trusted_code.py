# SPDX-License-Identifier: Apache-2.0
"""Trusted code: a name in a file is looked up in this project, in rsl_rl, and in what the user has named."""

from __future__ import annotations

import sys

import pytest
import yaml

from stripe_newton import trusted_code
from stripe_newton.cli import main, tasks
from stripe_newton.trusted_code import trust, trusted_packages, why_not_trusted
from tests.helpers.fake_env import TASK
from tests.helpers.fake_runner import make_runner


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A module that leaves a file where it is imported."""
    (tmp_path / "evilmod.py").write_text("open('pwned', 'w').close()\nclass Model: pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(trusted_code, "_packages", set(trusted_packages()))
    yield tmp_path / "pwned"
    sys.modules.pop("evilmod", None)


def test_names(evil):
    for name in ("MLPModel", "rsl_rl.models:MLPModel", "stripe_newton.rl.runs.log_writers:RunLogWriter"):
        assert why_not_trusted(name) == ""
    for name in ("evilmod:Model", "evilmod.Model", "os:system"):
        assert f"is '{name}', of a module that is not trusted; if you trust it, add --import" in why_not_trusted(name)
    # What a trusted module has imported is not its own.
    assert "which is of rsl_rl" not in why_not_trusted("rsl_rl.models:MLPModel")
    assert "not of 'stripe_newton' itself" in why_not_trusted("stripe_newton.file_lock:os.system")
    assert "which is not there" in why_not_trusted("rsl_rl.models:Nothing")
    assert "must be a name of rsl_rl's" in why_not_trusted(":x")
    assert not evil.exists()
    trust("evilmod.part")
    assert why_not_trusted("evilmod:Model") == ""
    assert evil.exists()


def test_a_class_of_the_user_that_cannot_be_made(evil, capsys, monkeypatch):
    model = "class Model:\n    def __init__(self, *args, **fields):\n        self.{}\n"
    (evil.parent / "brokenmod.py").write_text("class Model: pass\n" + model.format("x").replace("Model", "Deep"))
    monkeypatch.setattr(tasks, "_imported", [])
    words = ["--import", "brokenmod", "train", TASK, "--num-envs", "4", "--max-iterations", "1", "--device", "cpu"]
    for name, message in (("Model", "brokenmod:Model: TypeError: Model() takes no arguments"),
                          ("Deep", "brokenmod.py:4: AttributeError: 'Deep' object has no attribute 'x'")):  # fmt: skip
        assert main([*words, "--agent.actor.class-name", f"brokenmod:{name}"]) == 2
        assert f"error: networks and algorithm: {message} (STRIPE_NEWTON_TRACEBACK=1" in capsys.readouterr().err


def test_options_and_sweeps_run_no_code(evil, capsys):
    words = ["train", TASK, "--device", "cpu"]
    sweep = evil.parent / "sweep.yaml"
    sweep.write_text("agent.algorithm.class-name: ['evilmod:Model']\n")
    for more in (["--agent.actor.class-name", "evilmod:Model"], ["--sweep", str(sweep)]):
        assert main([*words, *more]) == 2
        assert "class_name: is 'evilmod:Model', of a module that is not trusted" in capsys.readouterr().err
    assert not evil.exists()


def test_a_sweep_writes_to_no_place_of_its_own(evil, capsys):
    sweep = evil.parent / "sweep.yaml"
    sweep.write_text("env.sim.solver.save-to-mjcf: ['/tmp/elsewhere.xml']\n")
    assert main(["train", "Stripe-Cartpole-Direct-v0", "--device", "cpu", "--sweep", str(sweep)]) == 2
    assert "save-to-mjcf: names a place that is written, which no sweep varies" in capsys.readouterr().err


def test_a_run_folder_runs_no_code(evil, capsys):
    run = evil.parent / "logs" / "run"
    make_runner(run).learn(1)
    (run / "params" / "run.yaml").write_text(f"task: {TASK}\n")
    agent = run / "params" / "agent.yaml"
    saved = yaml.safe_load(agent.read_text())
    saved["actor"]["class_name"] = "evilmod:Model"
    agent.write_text(yaml.safe_dump(saved))
    words = ["--checkpoint", str(run), "--viewer", "none", "--steps", "2", "--device", "cpu"]
    assert main(["play", TASK, *words]) == 2
    assert "evilmod:Model', of a module that is not trusted" in " ".join(capsys.readouterr().err.split())
    assert not evil.exists()
    assert "evilmod" not in sys.modules
