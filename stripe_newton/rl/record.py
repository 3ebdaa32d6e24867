# SPDX-License-Identifier: Apache-2.0
"""Videos of a policy, and of a training while it runs."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import torch

from .policies import Policy
from .vec_env import RslRlVecEnvWrapper

__all__ = ["TrainingVideo", "record_video", "video_timing"]

MAX_FPS = 60.0


def video_timing(step_dt: float) -> tuple[int, float]:
    """Every how many steps a frame is taken, and the frames a second: real time, ``MAX_FPS`` at most."""
    stride = max(1, math.ceil(1.0 / (step_dt * MAX_FPS) - 1e-6))
    return stride, 1.0 / (step_dt * stride)


@torch.inference_mode()
def record_video(
    env: RslRlVecEnvWrapper, policy: Policy, path: str | os.PathLike, steps: int, seed: int | None = None
) -> Path:
    """Reset the environment, run ``policy`` for ``steps`` steps and write what ``env.render()`` shows to ``path``.

    Args:
        env: the wrapped environment, made with ``render_mode="rgb_array"``.
        policy: what chooses the actions.
        path: file to write, ``.mp4``.
        steps: number of steps.
        seed: seed of the reset.

    Returns:
        The file.
    """
    from stripe_newton.viewers import VideoWriter

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    stride, fps = video_timing(env.unwrapped.step_dt)
    obs = env.reset(seed=seed)
    policy.reset()
    with VideoWriter(path, fps) as video:
        for step in range(steps):
            if step % stride == 0:
                video.add(env.render())
            obs, _, dones, _ = env.step(policy(obs))
            policy.reset(dones)
    return path


class TrainingVideo:
    """Films a training from time to time without touching it: it renders the steps that the training takes anyway."""

    def __init__(self, env: RslRlVecEnvWrapper, folder: str | os.PathLike, interval: int, steps: int):
        """Film ``steps`` steps after every ``interval`` iterations, into ``folder``.

        Add :meth:`after_iteration` to the logger's ``iteration_hooks``.
        """
        self.env, self.folder, self.interval, self.steps = env, Path(folder), interval, steps
        self._stride, self._fps = video_timing(env.unwrapped.step_dt)
        self._path: Path | None = None
        self._video: Any = None
        self._taken = 0

    def after_iteration(self, iteration: int) -> None:
        """Start a film if one is due and none is running."""
        if self._path is None and (iteration + 1) % self.interval == 0:
            self._path = self.folder / f"iteration_{iteration + 1}.mp4"
            self._taken = 0
            self.env.step_hooks.append(self._after_step)

    def close(self) -> None:
        """End the film that is running."""
        if self._path is not None:
            self.env.step_hooks.remove(self._after_step)
            self._path = None
        if self._video is not None:
            video, self._video = self._video, None
            video.close()

    def _after_step(self) -> None:
        if self._video is None and self._path is not None:
            from stripe_newton.viewers import VideoWriter

            self.folder.mkdir(parents=True, exist_ok=True)
            self._video = VideoWriter(self._path, self._fps)
        if self._taken % self._stride == 0:
            self._video.add(self.env.render())
        self._taken += 1
        if self._taken >= self.steps:
            self.close()
