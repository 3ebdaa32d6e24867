# SPDX-License-Identifier: Apache-2.0
"""What is written into the frames of videos: text at the edges, numbers of an episode, arrows of velocities."""

from __future__ import annotations

import math
import types

import numpy as np
import pytest
import torch

from stripe_newton.rl import ZeroPolicy, record_video
from stripe_newton.rl.runs.film_overlay import FilmOverlay
from tests.helpers.fake_runner import make_env

GREY = np.full((180, 320, 3), 120, dtype=np.uint8)


def walker(command, velocity, yaw=0.0):
    """A direct environment whose robot stands at the origin, seen from above: 40 pixels are a metre, x points right."""
    pose = torch.tensor([[0.0, 0.0, 0.3, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]])
    data = types.SimpleNamespace(root_pose_w=pose, root_lin_vel_w=torch.tensor([[*velocity, 0.0]]))
    renderer = types.SimpleNamespace(project=lambda points: np.array([160, 90]) + 40.0 * points[:, :2] * [1, -1])
    inner = types.SimpleNamespace(
        step_dt=0.02, robot=types.SimpleNamespace(data=data), commands=torch.tensor([command]), renderer=renderer
    )
    return types.SimpleNamespace(unwrapped=inner)


def colored(picture, color):
    rows, columns = np.nonzero(np.abs(picture.astype(int) - color).max(axis=2) < 60)
    return columns.astype(float), rows.astype(float)


def test_text_stands_at_the_edges_and_nothing_else_changes():
    overlay = FilmOverlay(types.SimpleNamespace(unwrapped=types.SimpleNamespace(step_dt=0.02)), "Some-Task-v0", "note")
    drawn = overlay.draw(GREY)
    assert (drawn.shape, drawn.dtype) == (GREY.shape, GREY.dtype)
    np.testing.assert_array_equal(GREY, 120)
    changed = (drawn != GREY).any(axis=2)
    assert changed[:40, :150].mean() > 0.2
    assert changed[-30:, :200].mean() > 0.15
    assert not changed[45:140].any()
    assert drawn[:40, :150].max() > 240  # letters
    overlay.has_numbers = False
    assert not (overlay.draw(GREY)[45:] != GREY[45:]).any()
    overlay.note = "iteration 7"
    assert (overlay.draw(GREY)[:45] != drawn[:45]).any()


def test_numbers_are_those_of_the_episode():
    overlay = FilmOverlay(types.SimpleNamespace(unwrapped=types.SimpleNamespace(step_dt=0.5)), "t", env_index=1)
    blank = overlay.draw(GREY)
    rewards, no = torch.tensor([9.0, 0.25]), torch.zeros(2)
    for _ in range(3):
        overlay.after_step(rewards, no)
    assert (overlay._steps, overlay._reward, overlay._return) == (3, 0.25, 0.75)
    assert (overlay.draw(GREY)[-40:] != blank[-40:]).any()
    overlay.after_step(rewards, torch.tensor([0.0, 1.0]))
    assert (overlay._steps, overlay._return) == (0, 0.0)


@pytest.mark.parametrize("yaw", [0.0, 1.2])
def test_arrows_point_where_the_command_and_the_robot_go(yaw):
    # The command is ahead of the robot, which moves along -y of the world.
    picture = FilmOverlay(walker([1.5, 0.0, 0.0], (0.0, -1.0), yaw), "t").draw(GREY)[30:150]
    columns, rows = colored(picture, (255, 140, 40))
    where = np.array([columns.mean() - 160, 60 - rows.mean()])
    assert math.atan2(where[1], where[0]) == pytest.approx(yaw, abs=0.15)
    # From the robot to where it would be in 0.7 s.
    assert np.hypot(columns - 160, rows - 60).max() == pytest.approx(1.5 * 0.7 * 40.0, abs=3.0)
    columns, rows = colored(picture, (70, 200, 120))
    assert rows.mean() > 65
    assert abs(columns.mean() - 160) < 4


def test_videos_carry_it(tmp_path):
    av = pytest.importorskip("av")
    env = make_env()

    def frames(name, overlay):
        path = record_video(env, ZeroPolicy(env), tmp_path / name, steps=4, seed=1, overlay=overlay)
        with av.open(str(path)) as video:
            return [f.to_ndarray(format="rgb24").astype(int) for f in video.decode(video=0)]

    plain, written = frames("one.mp4", None), frames("two.mp4", FilmOverlay(env, "Some-Task-v0", "iteration 3"))
    assert len(plain) == len(written) == 4
    assert np.abs(plain[0] - written[0]).max() > 60
