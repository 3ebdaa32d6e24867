# SPDX-License-Identifier: Apache-2.0
"""Run folders: parameters, metrics, the learning curve and videos."""

from __future__ import annotations

import os

import numpy as np
import pytest
import torch

from stripe_newton.rl import (
    CheckpointError,
    RunFolder,
    TrainingVideo,
    ZeroPolicy,
    find_checkpoint,
    plot_learning_curve,
    read_metrics,
    record_video,
)
from tests.helpers.fake_runner import flat, make_env, make_runner


def test_run_folder(tmp_path):
    one, two = RunFolder.create(tmp_path, "exp", "name"), RunFolder.create(tmp_path, "exp", "name")
    assert one.path != two.path
    assert one.path.parent == tmp_path / "exp"
    runner = make_runner(one.path)
    runner.learn(2)
    params = one.read_params()
    assert params == {"env": runner.env.cfg.to_dict(), "agent": runner.agent_cfg.to_dict()}
    assert RunFolder.of_checkpoint(find_checkpoint(one.path)).path == one.path.resolve()
    assert list(one.path.glob("events.out.tfevents.*"))
    (one.params / "env.yaml").write_text("a: [")
    with pytest.raises(CheckpointError, match="is not valid YAML"):
        one.read_params()


def test_learning_curve(tmp_path):
    runner = make_runner(tmp_path)
    runner.learn()
    columns = read_metrics(tmp_path / "metrics.csv")
    assert columns["total_steps"] == [8 * 16 * n for n in range(1, 7)]
    assert all(0.0 < value < 3.0 for value in columns["Episode/distance"])
    path = plot_learning_curve(tmp_path / "metrics.csv", tmp_path / "curve.png", "fake")
    assert path.read_bytes()[:4] == b"\x89PNG"


def test_metrics_with_a_column_that_comes_late(tmp_path):
    from stripe_newton.rl.runs.metrics_csv import MetricsCsv

    metrics = MetricsCsv(tmp_path / "m.csv")
    metrics.write({"iteration": 0, "a": 1.0})
    metrics.write({"iteration": 1, "a": 2.0, "b": 3.0})
    columns = read_metrics(tmp_path / "m.csv")
    assert columns["a"] == [1.0, 2.0]
    assert np.isnan(columns["b"][0])
    assert columns["b"][1] == 3.0
    with open(tmp_path / "m.csv", "a") as file:
        file.write("2,4.0")  # a row that was cut short
    MetricsCsv(tmp_path / "m.csv", first_iteration=9)
    assert read_metrics(tmp_path / "m.csv")["iteration"] == [0.0, 1.0]


@pytest.mark.parametrize("content", [b"x,y\n1,2\n", b"iteration,a\nx,2\n", b"\xff\xfe", "pipe"])
def test_metrics_that_cannot_be_read_are_put_aside(tmp_path, capsys, content):
    from stripe_newton.rl.runs.metrics_csv import MetricsCsv

    file = tmp_path / "m.csv"
    os.mkfifo(file) if content == "pipe" else file.write_bytes(content)
    if content != b"x,y\n1,2\n":
        with pytest.raises(ValueError, match=r"m\.csv: is "):
            read_metrics(file)
    MetricsCsv(file, first_iteration=9).write({"iteration": 9})
    assert f"warning: {file}: " in (err := capsys.readouterr().err)
    assert "; it is m.csv.damaged now, and begins anew" in err
    assert read_metrics(file) == {"iteration": [9.0]}
    assert (tmp_path / "m.csv.damaged").exists()


def test_videos(tmp_path):
    av = pytest.importorskip("av")
    env = make_env()
    path = record_video(env, ZeroPolicy(env), tmp_path / "videos" / "one.mp4", steps=7)
    with av.open(str(path)) as video:
        assert len(list(video.decode(video=0))) == 7
        assert float(video.streams.video[0].average_rate) == pytest.approx(10.0)


def test_filming_does_not_change_a_training(tmp_path):
    pytest.importorskip("av")
    plain = make_runner(tmp_path / "plain")
    plain.learn()
    filmed = make_runner(tmp_path / "filmed")
    film = TrainingVideo(filmed.env, tmp_path / "filmed" / "videos", interval=2, steps=20)
    filmed.logger.iteration_hooks.append(film.after_iteration)
    filmed.learn()
    film.close()
    names = {path.name for path in (tmp_path / "filmed" / "videos").iterdir()}
    assert names == {"iteration_2.mp4", "iteration_4.mp4"}
    one, other = (flat(run.alg.save()) for run in (plain, filmed))
    assert all(torch.equal(value, other[key]) for key, value in one.items() if isinstance(value, torch.Tensor))
