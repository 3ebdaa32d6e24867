# SPDX-License-Identifier: Apache-2.0
"""Videos of a policy, and of a training while it runs."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from stripe_newton.rl.policies import Policy
from stripe_newton.rl.wrappers.rsl_rl import RslRlVecEnvWrapper
from stripe_newton.value_types import short

if TYPE_CHECKING:
    from stripe_newton.viewers import VideoWriter

    from .film_overlay import FilmOverlay

__all__ = ["TrainingVideo", "record_video", "video_steps", "video_timing"]

MAX_FPS = 60.0
"""Most frames that a video has in a second."""
VIDEO_SECONDS = 10.0
"""Longest video without an explicit length [s]."""
CPU_FPS, CPU_SECONDS = 30.0, 5.0
"""The same of the video at the end of a training on the CPU, where a frame takes as long as many steps."""


def video_timing(step_dt: float, most_fps: float = MAX_FPS) -> tuple[int, float]:
    """Steps from one frame to the next, and frames a second, for a video in real time of at most ``most_fps``."""
    # The small number keeps a step of exactly 1 / most_fps from being rounded up to two.
    stride = max(1, math.ceil(1.0 / (step_dt * most_fps) - 1e-6))
    return stride, 1.0 / (step_dt * stride)


def video_steps(env: RslRlVecEnvWrapper, seconds: float = VIDEO_SECONDS) -> int:
    """Steps of a video without an explicit length: an episode, but not longer than ``seconds``."""
    return max(1, min(int(env.max_episode_length), round(seconds / env.unwrapped.step_dt)))


@torch.inference_mode()
def record_video(
    env: RslRlVecEnvWrapper,
    policy: Policy,
    path: str | os.PathLike,
    steps: int,
    seed: int | None = None,
    most_fps: float = MAX_FPS,
    overlay: FilmOverlay | None = None,
    progress: Callable[[int], None] | None = None,
) -> Path:
    """Reset the environment, run ``policy`` and write what ``env.render()`` shows to a video.

    Args:
        env: The wrapped environment, made with ``render_mode="rgb_array"``.
        policy: What chooses the actions.
        path: The file, ``.mp4``.
        steps: Number of steps.
        seed: Seed of the reset.
        most_fps: Most frames a second.
        overlay: What is written into the frames.
        progress: Called after each step with the number of steps so far.

    Returns:
        The file.

    Raises:
        ValueError: if the number of steps is no whole number of at least 1, or the environment draws no pictures.
        OSError: if the file cannot be written.
    """
    from stripe_newton.viewers import VideoWriter  # here, as many runs make no video, and it loads a video library

    if isinstance(steps, bool) or not isinstance(steps, int) or steps < 1:
        raise ValueError(f"steps: is {short(steps)}, must be a whole number of at least 1")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    stride, fps = video_timing(env.unwrapped.step_dt, most_fps)
    obs = env.reset(seed=seed)
    policy.reset()
    if overlay is not None:
        overlay.restart()
    with VideoWriter(path, fps) as video:
        for step in range(steps):
            if step % stride == 0:
                video.add(_picture(env, overlay))
            obs, rewards, dones, _ = env.step(policy(obs))
            policy.reset(dones)
            if overlay is not None:
                overlay.after_step(rewards, dones)
            if progress is not None:
                progress(step + 1)
    return path


def _picture(env: RslRlVecEnvWrapper, overlay: FilmOverlay | None) -> np.ndarray:
    picture = env.render()
    if picture is None:
        raise ValueError("the environment draws no pictures; make it with render_mode='rgb_array'")
    return picture if overlay is None else overlay.draw(picture)


class TrainingVideo:
    """Videos of a training at intervals. It renders steps that the training takes anyway, so it changes nothing."""

    def __init__(
        self, env: RslRlVecEnvWrapper, folder: str | os.PathLike, interval: int, steps: int, task: str | None = None
    ):
        """Prepare videos; add :meth:`after_iteration` to the logger's ``iteration_hooks``.

        Args:
            env: The wrapped environment, made with ``render_mode="rgb_array"``.
            folder: Folder of the videos.
            interval: Iterations from one video to the next.
            steps: Steps of a video.
            task: Name that is written into the frames, with iteration and reward. None: nothing is.
        """
        self.env, self.folder, self.interval, self.steps = env, Path(folder), interval, steps
        self._stride, self._fps = video_timing(env.unwrapped.step_dt)
        self._path: Path | None = None
        self._video: VideoWriter | None = None
        self._taken = 0
        self._overlay: FilmOverlay | None = None
        if task is not None:
            from .film_overlay import FilmOverlay

            self._overlay = FilmOverlay(env, task)
            # Environments of other packages may keep no rewards.
            self._overlay.has_numbers = hasattr(env.unwrapped, "reward_buf") and hasattr(env.unwrapped, "reset_buf")

    def after_iteration(self, iteration: int) -> None:
        """Begin a video if one is due and none is running."""
        if self._path is None and (iteration + 1) % self.interval == 0:
            self._path = self.folder / f"iteration_{iteration + 1}.mp4"
            self._taken = 0
            if self._overlay is not None:
                self._overlay.note = f"iteration {iteration + 1}"
                self._overlay.restart()
            # A hook only while a video runs: with one, the rollout hands out observations after each step.
            self.env.step_hooks.append(self._after_step)

    def close(self) -> None:
        """End the video that is running."""
        if self._path is not None:
            self.env.step_hooks.remove(self._after_step)
            self._path = None
        if self._video is not None:
            video, self._video = self._video, None
            try:
                video.close()
            except OSError as error:
                print(f"\nwarning: {video.path}: could not be written: {error.strerror or error}", file=sys.stderr)

    def _after_step(self) -> None:
        if self._video is None:
            from stripe_newton.viewers import VideoWriter  # see `record_video`

            assert self._path is not None  # this hook is there only while a video runs
            self._video = VideoWriter(self._path, self._fps)
        try:
            if self._taken % self._stride == 0:
                self._video.add(_picture(self.env, self._overlay))
        except OSError as error:
            self._give_up(error)
            return
        inner = self.env.unwrapped
        reward, done = getattr(inner, "reward_buf", None), getattr(inner, "reset_buf", None)
        if self._overlay is not None and self._overlay.has_numbers and reward is not None and done is not None:
            self._overlay.after_step(reward, done)
        self._taken += 1
        if self._taken >= self.steps:
            self.close()

    def _give_up(self, error: OSError) -> None:
        """Leave this video out: a full disk must not end a training."""
        print(f"\nwarning: {self._path}: could not be written: {error.strerror or error}", file=sys.stderr)
        if self._video is not None:
            self._video.discard()
            self._video = None
        self.close()
