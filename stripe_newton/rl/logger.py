# SPDX-License-Identifier: Apache-2.0
"""rsl_rl's logger with one line of progress in place of its block, and a state that can be saved."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import time
from collections import deque
from collections.abc import Callable
from datetime import timedelta
from typing import Any, TextIO

from rsl_rl.utils.log_writer import LogWriter
from rsl_rl.utils.logger import Logger

from .distributed import exchange, stop_asked
from .metrics import RankLogWriter, RunLogWriter, merge_rows

__all__ = ["RunLogger", "StopTraining"]

_BUFFERS = ("rewbuffer", "lenbuffer", "erewbuffer", "irewbuffer")
_SUMS = ("cur_reward_sum", "cur_episode_length", "cur_ereward_sum", "cur_ireward_sum")
_SECONDS_BETWEEN_LINES = 5.0


class StopTraining(Exception):
    """Ends rsl_rl's learning loop after an iteration that is complete."""


class RunLogger(Logger):
    """Does what rsl_rl's logger does, prints one line, counts iterations, and ends the loop when asked."""

    writer: LogWriter | None

    def __init__(self, **kwargs: Any):
        """Take the arguments of rsl_rl's ``Logger``."""
        super().__init__(**kwargs)
        self.is_distributed: bool = kwargs["is_distributed"]
        self.iterations_done = 0
        self.stop_requested = False
        self.ahead = False
        """Whether the next iteration has begun already when one is logged; the run does not stop then."""
        self.read_std: Callable[[], Any] | None = None
        """Gives the standard deviation of the actions that is logged, where the actor does not know it."""
        self._stop_agreed = False
        self.iteration_hooks: list[Callable[[int], None]] = []
        """Called with the iteration after each, before its checkpoint."""
        self._progress = _Progress(sys.stdout)

    def init_logging_writer(self) -> None:
        """Open the writers; of what they hold, this keeps the iterations that were done."""
        self._stop_agreed = False
        self._progress = _Progress(sys.stdout)
        configured = self.cfg.get("logger", "tensorboard")
        self.cfg["logger"] = {
            "class_name": f"{RunLogWriter.__module__}:{RunLogWriter.__qualname__}",
            "first_iteration": self.iterations_done,
            "also": None if configured == "tensorboard" else configured,
        }
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # it tells which folders are no git repository
                super().init_logging_writer()
        finally:
            self.cfg["logger"] = configured
        if self.log_dir is not None and self.disable_logs:
            self.writer = RankLogWriter()
        elif self.log_dir is not None:
            with contextlib.suppress(OSError):
                os.rmdir(os.path.join(self.log_dir, "git"))  # empty where the task is in no git repository

    def log(self, it: int, start_it: int, total_it: int, collect_time: float, learn_time: float, **values: Any) -> None:
        """Log an iteration; with several ranks the means of what they all have.

        Raises:
            StopTraining: if the run was asked to stop; all ranks stop after the same iteration.
        """
        times = {"collect_time": collect_time, "learn_time": learn_time}
        if self.read_std is not None:
            values["action_std"] = self.read_std()
        with contextlib.redirect_stdout(io.StringIO()):
            super().log(it=it, start_it=start_it, total_it=total_it, **times, **values)
        self.iterations_done = it + 1
        row = self.writer.take_row() if isinstance(self.writer, (RunLogWriter, RankLogWriter)) else {}
        stop = self._stop_agreed
        if self.is_distributed:
            told = exchange((row, self.stop_requested or stop_asked()))
            row = merge_rows([other for other, _ in told])
            self._stop_agreed = any(asked for _, asked in told)  # for the next: some ranks are ahead, some are not
            self.stop_requested = self._stop_agreed
        if isinstance(self.writer, RunLogWriter):
            self.writer.end_iteration(it, row, self.tot_timesteps, self.tot_time)
            steps_per_s = self.cfg["num_steps_per_env"] * self.num_envs * self.gpu_world_size / sum(times.values())
            reward, length = row.get("Train/mean_reward"), row.get("Train/mean_episode_length")
            self._progress.show(it + 1, total_it, reward, length, steps_per_s, self.tot_time)
        for hook in self.iteration_hooks:
            hook(it)
        if not self.is_distributed:
            stop = self.stop_requested and not self.ahead
        if stop and it + 1 < total_it:
            raise StopTraining

    def stop_logging_writer(self) -> None:
        """Close the writers."""
        super().stop_logging_writer()
        self.writer = None

    def forget_episodes(self) -> None:
        """Count the running episodes from zero, without those that were cut."""
        for name in _SUMS:
            if hasattr(self, name):
                getattr(self, name).zero_()

    def get_state(self) -> dict[str, Any]:
        """Totals and the returns and lengths of episodes, finished and running."""
        state: dict[str, Any] = {"tot_timesteps": self.tot_timesteps, "tot_time": self.tot_time}
        state |= {name: list(getattr(self, name)) for name in _BUFFERS if hasattr(self, name)}
        return state | {name: getattr(self, name) for name in _SUMS if hasattr(self, name)}

    def set_state(self, state: dict[str, Any], episodes_go_on: bool) -> None:
        """Put back what :meth:`get_state` returned; sums of running episodes only if those go on."""
        self.tot_timesteps, self.tot_time = state["tot_timesteps"], state["tot_time"]
        for name in _BUFFERS:
            if hasattr(self, name) and name in state:
                setattr(self, name, deque(state[name], maxlen=getattr(self, name).maxlen))
        for name in _SUMS if episodes_go_on else ():
            if hasattr(self, name) and name in state:
                getattr(self, name).copy_(state[name])


class _Progress:
    """One line an iteration: rewritten in place on a terminal, now and then in a file."""

    def __init__(self, out: TextIO):
        self.out = out
        self.in_place = out.isatty()
        self.recent: deque[float] = deque([time.monotonic()], maxlen=30)
        self.next_line = 0.0

    def show(
        self, done: int, total: int, reward: float | None, length: float | None, steps_per_s: float, elapsed: float
    ) -> None:
        now = time.monotonic()
        left = (now - self.recent[0]) / len(self.recent) * (total - done)
        self.recent.append(now)
        if not self.in_place and now < self.next_line and done < total:
            return
        self.next_line = now + _SECONDS_BETWEEN_LINES
        text = (
            f"iteration {done:>{len(str(total))}}/{total}"
            f"  reward {'-' if reward is None else format(reward, '.2f'):>8}"
            f"  length {'-' if length is None else format(length, '.1f'):>7}"
            f"  {steps_per_s:>9,.0f} steps/s"
            f"  elapsed {timedelta(seconds=int(elapsed))}  left {timedelta(seconds=int(left))}"
        )
        if not self.in_place:
            print(text, file=self.out, flush=True)
        else:
            print(f"\r\033[K{text}", end="\n" if done == total else "", file=self.out, flush=True)
