# SPDX-License-Identifier: Apache-2.0
"""Command ``stripe-newton replay-motion``: table, video and errors, with the quadruped of the tasks."""

from __future__ import annotations

import av
import numpy as np
import pytest

from stripe_newton.cli import main
from stripe_tasks.robots import QUADRUPED_CFG
from tests.helpers.motion_files import write_motion

ROBOT = QUADRUPED_CFG.spawn.usd_path


@pytest.fixture
def motion(tmp_path):
    path = tmp_path / "sway_30hz.csv"
    write_motion(path, [0.0, 0.8, -1.5] * 4, seconds=0.5, fps=30.0, seed=0)
    return path


def test_a_video_has_a_picture_for_each_frame_and_the_robot_moves(motion, tmp_path, capsys):
    out = tmp_path / "motion.mp4"
    words = ["replay-motion", str(motion), "--robot", ROBOT, "--viewer", "video", "--out", str(out)]
    assert main([*words, "--fps", "10", "--resolution", "96", "64"]) == 0
    printed = capsys.readouterr().out
    assert "sway_30hz.csv" in printed
    assert str(out) in printed
    with av.open(str(out)) as container:
        pictures = [frame.to_ndarray(format="rgb24").astype(float) for frame in container.decode(video=0)]
    assert len(pictures) == 6  # 0.5 s at 10 Hz, with both ends
    assert np.abs(pictures[0] - pictures[-1]).mean() > 0.5


def test_what_is_wrong_is_one_message(motion, tmp_path, capsys):
    few = tmp_path / "few.csv"
    write_motion(few, [0.0] * 3, seconds=0.5, fps=30.0, seed=0)
    for words, message in (
        ([str(few), "--robot", ROBOT], "few.csv: has 3 joints, the robot has 12"),
        ([str(tmp_path / "none.csv")], "none.csv: is neither a file nor a folder"),
        ([str(motion), "--robot", "g2"], "--robot g2: robot 'g2' is not in the table; did you mean"),
        ([str(motion), "--fps", "0"], "--fps 0: must be above 0"),
        ([], "replay-motion needs files"),
    ):
        assert main(["replay-motion", *words, "--viewer", "none"]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert "Traceback" not in said
