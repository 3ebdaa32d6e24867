# SPDX-License-Identifier: Apache-2.0
"""``train --teacher``: a student with a camera and a memory learns from a policy that was trained before."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import yaml

from stripe_newton.cli import main
from stripe_newton.rl import read_metrics
from tests.helpers.depth_cartpole import TEACHER_TASK, register

TASK = register()


@pytest.fixture(scope="module")
def teacher(tmp_path_factory) -> Path:
    """A short run of the teacher's task."""
    logs = tmp_path_factory.mktemp("teacher")
    options = ["--device", "cpu", "--num-envs", "64", "--max-iterations", "4", "--final-video", "False"]
    assert main(["train", TEACHER_TASK, *options, "--log-dir", str(logs)]) == 0
    return next(next(logs.iterdir()).iterdir())


def error_of(capsys, *args: str) -> str:
    """The message of a command that ends with code 2."""
    capsys.readouterr()
    assert main(["train", *args, "--device", "cpu"]) == 2
    return capsys.readouterr().err


def test_a_student_learns_from_a_teacher_that_may_then_go(tmp_path, monkeypatch, teacher):
    monkeypatch.chdir(tmp_path)
    own = Path(shutil.copytree(teacher, tmp_path / "teacher"))
    options = ["--device", "cpu", "--num-envs", "32", "--final-video", "False"]
    assert main(["train", TASK, "--teacher", str(own), *options, "--max-iterations", "20"]) == 0
    run = next(Path("logs/depth_cartpole").iterdir())
    losses = list(read_metrics(run / "metrics.csv")["Loss/behavior"])
    assert len(losses) == 20
    assert sum(losses[-3:]) < 0.3 * sum(losses[:3])
    # The exporter compares ONNX and TorchScript with the policy, its memory included.
    exported = json.loads((run / "exported" / "policy.json").read_text())
    assert [entry["name"] for entry in exported["network"]["inputs"]] == ["obs", "depth"]
    assert [state["input"] for state in exported["network"]["states"]] == ["h_in"]
    shutil.rmtree(own)
    evaluate = ["eval", TASK, "--checkpoint", str(run), "--episodes", "4", "--device", "cpu", "--json", "found.json"]
    assert main(evaluate) == 0
    by_onnx = [*evaluate[:3], str(run / "exported" / "policy.onnx"), *evaluate[4:-1], "onnx.json"]
    assert main(by_onnx) == 0
    one, other = (json.loads(Path(name).read_text())["mean_return"] for name in ("found.json", "onnx.json"))
    assert one == pytest.approx(other, rel=0.05)
    assert main(["train", TASK, "--resume", str(run), *options, "--max-iterations", "21"]) == 0
    assert len(read_metrics(run / "metrics.csv")["Loss/behavior"]) == 21


def test_wrong_teachers_are_named(tmp_path, monkeypatch, capsys, teacher):
    monkeypatch.chdir(tmp_path)
    assert f"{TASK} learns from a teacher: give --teacher RUN" in error_of(capsys, TASK)
    message = error_of(capsys, TEACHER_TASK, "--teacher", str(teacher))
    assert f"{TEACHER_TASK} is trained by PPO; --teacher is for tasks that are distilled" in message
    assert "nowhere: does not exist" in error_of(capsys, TASK, "--teacher", "nowhere")
    alone = Path(shutil.copy(next((teacher / "checkpoints").iterdir()), tmp_path / "alone.pt"))
    assert "is in no run folder" in error_of(capsys, TASK, "--teacher", str(alone))
    other = Path(shutil.copytree(teacher, tmp_path / "other"))
    saved = yaml.safe_load((other / "params" / "env.yaml").read_text())
    terms = saved["observations"]["policy"]
    names = [name for name, term in terms.items() if isinstance(term, dict) and "func" in term]
    terms[names[0]]["scale"] = 2.0
    (other / "params" / "env.yaml").write_text(yaml.safe_dump(saved, sort_keys=False))
    message = error_of(capsys, TASK, "--teacher", str(other), "--max-iterations", "1")
    assert f"{names[0]}.scale: 2.0 for the teacher, here None" in message
    del terms[names[0]]
    (other / "params" / "env.yaml").write_text(yaml.safe_dump(saved, sort_keys=False))
    message = error_of(capsys, TASK, "--teacher", str(other), "--max-iterations", "1")
    assert f"its policy observes {', '.join(names[1:])}; teacher of {TASK} has {', '.join(names)}" in message
    assert not Path("logs").exists()
