# SPDX-License-Identifier: Apache-2.0
"""Status panel: task, time, episode and rewards of the live view, and the iteration of a training."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch

from .time_control import TimeControl
from .viewed_env import ViewedEnv

if TYPE_CHECKING:
    import viser

__all__ = ["EpisodeMeter", "StatusPanel"]

_EVERY = 0.25
"""Time between two updates of the text [s]."""
_ENDLESS = 10_000_000
"""Steps from which an episode has no end."""


class EpisodeMeter:
    """Returns of episodes, added up on the device: nothing is read until somebody looks."""

    def __init__(self, env: ViewedEnv):
        self._env = env
        self.running = torch.zeros_like(env.reward_buf, dtype=torch.float32)
        """Sum of the rewards in the current episodes, shape ``(num_envs,)``."""
        self._ended = torch.zeros(2, device=self.running.device)

    @torch.no_grad()
    def after_step(self) -> None:
        """Count the rewards of a step."""
        ends = self._env.reset_buf.bool()
        self.running += self._env.reward_buf
        self._ended[0] += torch.where(ends, self.running, 0.0).sum()
        self._ended[1] += ends.sum()
        self.running.masked_fill_(ends, 0.0)

    def clear(self) -> None:
        """Begin anew, as after a reset or with another policy."""
        self.running.zero_()
        self._ended.zero_()

    def mean_return(self) -> tuple[float, int]:
        """Mean return of the episodes that ended, and their number."""
        total, count = self._ended.tolist()
        return (total / count if count else float("nan")), int(count)


class StatusPanel:
    """A few lines of text above all other panels.

    Args:
        gui: Where the text goes.
        title: What is shown: a task or a file.
        clock: The time of the view.
        env: The environment; None for a scene without one.
    """

    def __init__(self, gui: viser.GuiApi, title: str, clock: TimeControl, env: ViewedEnv | None):
        self._title, self._clock, self._env = title, clock, env
        self.meter = None if env is None else EpisodeMeter(env)
        self._more: dict[str, str] = {}
        self._next = 0.0
        self.text = gui.add_markdown(f"**{_plain(title)}**", order=-10.0)

    def set_lines(self, lines: Mapping[str, str]) -> None:
        """Show further lines, such as the iteration of a training, by name; an empty text takes one away."""
        self._more |= lines
        self._more = {name: text for name, text in self._more.items() if text}
        self._next = 0.0

    def hide(self) -> None:
        """Take the text off the page, as nothing happens."""
        self.text.visible = False

    def update(self, env_id: int, at_once: bool = False) -> None:
        """Write the text anew, a few times a second."""
        now = time.monotonic()
        if now < self._next and not at_once:
            return
        self._next = now + _EVERY
        rows = [("time", self._time()), *self._episode(env_id), *self._more.items()]
        table = "\n".join(f"| {_plain(name)}&nbsp;&nbsp; | {_plain(text)} |" for name, text in rows)
        self.text.content = f"| | |\n|:--|:--|\n{table}"

    def _time(self) -> str:
        if self._clock.is_paused:
            return "paused"
        return f"{self._clock.factor:.2g} x real time"

    def _episode(self, env_id: int) -> list[tuple[str, str]]:
        env = self._env
        if env is None or self.meter is None:
            return []
        length = int(env.episode_length_buf[env_id])
        limit = f" of {env.max_episode_length}" if env.max_episode_length < _ENDLESS else ""
        rows = [("episode", f"step {length}{limit}, {length * env.step_dt:.2f} s")]
        if not getattr(getattr(env, "reward_manager", None), "active_terms", True):
            return rows  # a scene without a task
        reward, total = float(env.reward_buf[env_id]), float(self.meter.running[env_id])
        rows.append(("reward", f"{reward:.3g} in this step, {total:.3g} in this episode"))
        mean, count = self.meter.mean_return()
        if count:
            rows.append(("return", f"{mean:.4g}, mean of {count} episode{'s'[: count > 1]}"))
        return rows


def _plain(text: str) -> str:
    """Text that Markdown shows as it is."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>()#+!|~" else c for c in text)
