# SPDX-License-Identifier: Apache-2.0
"""Live view of a training: shows the environments during the training, without cost while no page is open."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from stripe_newton.rl.runner import OnPolicyRunner
    from stripe_newton.viewers import LiveViewer

__all__ = ["TrainingView"]


class TrainingView:
    """Keeps a viewer at work between the steps of a training.

    Without a browser it looks once in an iteration whether there is one. With one it draws after a step where a picture
    is due, and pauses the training where the page says so.
    """

    def __init__(self, runner: OnPolicyRunner, viewer: LiveViewer):
        """Prepare; add :meth:`after_iteration` to the logger's ``iteration_hooks``.

        Args:
            runner: The runner.
            viewer: A viewer of its environment, not paced and without a reset.
        """
        self._runner, self._viewer = runner, viewer
        self._last = time.monotonic(), runner.logger.tot_timesteps
        self._is_watched = False
        self._say(runner.iterations_done, 0.0)
        self._watch(viewer.has_clients())

    def after_iteration(self, iteration: int) -> None:
        """Show how far the training is, and begin or end to draw."""
        then, steps = self._last
        self._last = now, total = time.monotonic(), self._runner.logger.tot_timesteps
        self._say(iteration + 1, (total - steps) / max(now - then, 1.0e-9))
        self._watch(self._viewer.has_clients())
        self._viewer.serve()

    def close(self) -> None:
        """Draw no longer."""
        self._watch(False)

    def _watch(self, is_watched: bool) -> None:
        """Draw after each step, or not: with a hook, the rollout publishes observations after each step."""
        if is_watched != self._is_watched:
            self._is_watched = is_watched
            hooks = self._runner.env.step_hooks
            (hooks.append if is_watched else hooks.remove)(self._after_step)

    @torch.inference_mode(False)
    def _after_step(self) -> None:
        self._viewer.after_step()
        self._viewer.serve()

    def _say(self, done: int, steps_per_s: float) -> None:
        logger = self._runner.logger
        lines = {"iteration": f"{done} of {self._runner.agent_cfg.max_iterations}"}
        if len(logger.rewbuffer):
            mean = sum(logger.rewbuffer) / len(logger.rewbuffer)
            length = sum(logger.lenbuffer) / len(logger.lenbuffer)
            lines["training"] = f"mean return {mean:.4g}, mean length {length:.4g}"
        if steps_per_s:
            lines["speed"] = f"{steps_per_s:,.0f} steps/s"
        self._viewer.set_status(lines)
