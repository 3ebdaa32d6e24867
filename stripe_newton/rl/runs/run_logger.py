# SPDX-License-Identifier: Apache-2.0
"""RunLogger: rsl_rl's logger with one line of progress, a state that can be saved, and a clean stop."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import TextIO, TypedDict

import torch
from rsl_rl.utils.log_writer import LogWriter
from rsl_rl.utils.logger import Logger

from stripe_newton.rl.distributed import exchange, stop_asked
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt

from .divergence import check_losses
from .log_writers import RankLogWriter, RunLogWriter
from .metrics_csv import merge_rows
from .run_folder import RunFolder

__all__ = ["LoggerState", "RunLogger", "StopTraining"]

_SECONDS_BETWEEN_LINES = 5.0
_CLOCK_S = 1.0
"""Difference of two clocks that does not matter [s]."""


class StopTraining(Exception):
    """Ends the learning loop after an iteration that is complete."""


class LoggerState(TypedDict, total=False):
    """Totals of a run, and the episodes that its log is averaged over. The keys are names of rsl_rl's attributes."""

    tot_timesteps: NonNegativeInt
    """Samples of all environments."""
    tot_time: NonNegativeFloat
    """Duration of all iterations [s]."""
    rewbuffer: list[float]
    """Returns of the last episodes that ended."""
    lenbuffer: list[float]
    """Lengths of the same episodes."""
    erewbuffer: list[float]
    """With RND: their returns without the intrinsic reward."""
    irewbuffer: list[float]
    """With RND: their intrinsic returns."""
    cur_reward_sum: torch.Tensor
    """Returns so far of the running episodes, ``(num_envs,)``."""
    cur_episode_length: torch.Tensor
    """Lengths so far of the running episodes, ``(num_envs,)``."""
    cur_ereward_sum: torch.Tensor
    """With RND: returns so far without the intrinsic reward, ``(num_envs,)``."""
    cur_ireward_sum: torch.Tensor
    """With RND: intrinsic returns so far, ``(num_envs,)``."""


class RunLogger(Logger):
    """rsl_rl's logger that prints one line in place of a block, counts iterations, and ends the loop when asked."""

    writer: LogWriter | None
    device: str

    def __init__(
        self,
        log_dir: str | None,
        cfg: dict,
        env_cfg: object,
        num_envs: int,
        is_distributed: bool,
        gpu_world_size: int,
        gpu_global_rank: int,
        device: str,
    ) -> None:
        """Take the arguments of rsl_rl's ``Logger``."""
        super().__init__(log_dir, cfg, env_cfg, num_envs, is_distributed, gpu_world_size, gpu_global_rank, device)
        # rsl_rl makes the second ones only for random network distillation.
        rnd = bool(cfg["algorithm"].get("rnd_cfg"))
        self._buffers = ("rewbuffer", "lenbuffer", *(("erewbuffer", "irewbuffer") if rnd else ()))
        self._sums = ("cur_reward_sum", "cur_episode_length", *(("cur_ereward_sum", "cur_ireward_sum") if rnd else ()))
        self.is_distributed = is_distributed
        self.iterations_done = 0
        self.stop_requested = False
        self.ahead = False
        """Whether the next iteration has already begun when one is logged; then the run does not stop yet."""
        self.read_std: Callable[[], torch.Tensor] | None = None
        """Returns the standard deviation of the actions for the log, where that of the actor is not the right one."""
        self._stop_agreed = False
        self.iteration_hooks: list[Callable[[int], None]] = []
        """Called with the number of the iteration after each, before its checkpoint."""
        self._progress = _Progress(sys.stdout)
        self._last = time.monotonic()

    def init_logging_writer(self) -> None:
        """Open the writers. What they have of iterations that are not done is dropped."""
        self._stop_agreed = False
        self._progress = _Progress(sys.stdout)
        # rsl_rl makes the writer that its config names, so for a moment the config names ours.
        configured = self.cfg.get("logger", "tensorboard")
        self.cfg["logger"] = {
            "class_name": f"{RunLogWriter.__module__}:{RunLogWriter.__qualname__}",
            "first_iteration": self.iterations_done,
            "also": None if configured == "tensorboard" else configured,
        }
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints which folders are no git repository
                super().init_logging_writer()
        finally:
            self.cfg["logger"] = configured
        if self.log_dir is not None and self.disable_logs:
            self.writer = RankLogWriter()
        elif self.log_dir is not None:
            with contextlib.suppress(OSError):
                os.rmdir(os.path.join(self.log_dir, "git"))  # empty where the task is in no git repository

    def log(
        self,
        it: int,
        start_it: int,
        total_it: int,
        collect_time: float,
        learn_time: float,
        loss_dict: dict,
        learning_rate: float,
        action_std: torch.Tensor,
        rnd_weight: float | None,
        **layout: int | bool,
    ) -> None:
        """Log an iteration. With several ranks the values are means over the ranks.

        The arguments are those of rsl_rl's ``Logger.log``.

        Raises:
            DivergedError: if a loss is not finite.
            StopTraining: if the run was asked to stop; all ranks stop after the same iteration.
        """
        check_losses(loss_dict, it, None if self.log_dir is None else RunFolder(self.log_dir))
        if self.read_std is not None:
            action_std = self.read_std()
        with contextlib.redirect_stdout(io.StringIO()), self._on_host():
            times = self._true_times(collect_time, learn_time)
            super().log(it, start_it, total_it, *times, loss_dict, learning_rate, action_std, rnd_weight, **layout)
        self.iterations_done = it + 1
        # rsl_rl has given its numbers to the writer one by one; now that they are complete they are one row.
        row = self.writer.take_row() if isinstance(self.writer, (RunLogWriter, RankLogWriter)) else {}
        row, stop = self._agree(row)
        if isinstance(self.writer, RunLogWriter):
            self.writer.end_iteration(it, row, self.tot_timesteps, self.tot_time)
            samples = self.cfg["num_steps_per_env"] * self.num_envs * self.gpu_world_size
            reward, length = row.get("Train/mean_reward"), row.get("Train/mean_episode_length")
            steps_per_s = samples / sum(times)
            self._progress.show(it + 1, total_it, reward, length, steps_per_s, self.tot_time)
        for hook in self.iteration_hooks:
            hook(it)
        if not self.is_distributed:
            # After the hooks, which may ask for a stop.
            stop = self.stop_requested and not self.ahead
        if stop and it + 1 < total_it:
            raise StopTraining

    def _true_times(self, collect_time: float, learn_time: float) -> tuple[float, float]:
        """The times of an iteration [s], without jumps of the system's clock, by which rsl_rl measures them."""
        now = time.monotonic()
        most, self._last = now - self._last, now
        whole = collect_time + learn_time
        # Twice: where iterations overlap, one may be logged late and the next one early.
        if collect_time >= 0.0 and learn_time >= 0.0 and 0.0 < whole <= 2.0 * most + _CLOCK_S:
            return collect_time, learn_time
        return max(most, 1e-3), 0.0

    @contextlib.contextmanager
    def _on_host(self) -> Iterator[None]:
        """Let rsl_rl average the environment's log on the host, if it is on the host.

        On the device each of its values would wait for all that is queued there, such as the next rollout.
        """
        values = (value for info in self.ep_extras for value in info.values())
        device = self.device
        if not any(isinstance(value, torch.Tensor) and value.is_cuda for value in values):
            self.device = "cpu"
        try:
            yield
        finally:
            self.device = device

    def _agree(self, row: dict[str, float]) -> tuple[dict[str, float], bool]:
        """The row of all ranks, and whether they stop after this iteration."""
        stop = self._stop_agreed
        if self.is_distributed:
            answers = exchange((row, self.stop_requested or stop_asked()))
            row = merge_rows([other for other, _ in answers])
            # For the next iteration rather than this one: some ranks have queued work of the next one already, others
            # have not, and all must have taken part in the same number of collective calls.
            self._stop_agreed = any(asked for _, asked in answers)
            self.stop_requested = self._stop_agreed
        return row, stop

    def stop_logging_writer(self) -> None:
        """Close the writers."""
        super().stop_logging_writer()
        self.writer = None  # which says that no training is under way

    def clear_episodes(self) -> None:
        """Count the running episodes from zero, as after a cut of all episodes."""
        for name in self._sums:
            getattr(self, name).zero_()

    def get_state(self) -> LoggerState:
        """Totals, and returns and lengths of episodes, finished and running."""
        state: LoggerState = {"tot_timesteps": self.tot_timesteps, "tot_time": self.tot_time}
        state |= {name: list(getattr(self, name)) for name in self._buffers}  # type: ignore[typeddict-item]
        return state | {name: getattr(self, name) for name in self._sums}  # type: ignore[return-value]

    def set_state(self, state: LoggerState, episodes_go_on: bool) -> None:
        """Put back what :meth:`get_state` returned; returns and lengths of running episodes only if those go on."""
        self.tot_timesteps, self.tot_time = state["tot_timesteps"], state["tot_time"]
        values: dict[str, object] = dict(state)
        for name in self._buffers:
            if isinstance(found := values.get(name), list):
                setattr(self, name, deque(found, maxlen=getattr(self, name).maxlen))
        for name in self._sums if episodes_go_on else ():
            if name in values:
                # In place: the rollout's graph adds to this memory.
                getattr(self, name).copy_(values[name])


class _Progress:
    """One line for each iteration: rewritten in place on a terminal, printed now and then to a file."""

    def __init__(self, out: TextIO):
        self.out = out
        self.in_place = out.isatty()
        self.recent: deque[float] = deque([time.monotonic()], maxlen=30)
        self.next_line = 0.0

    def show(
        self, done: int, total: int, reward: float | None, length: float | None, steps_per_s: float, elapsed: float
    ) -> None:
        """Show how far the run is, with the time left by the last 30 iterations."""
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
        with contextlib.suppress(OSError):  # a terminal that was closed must not end the run before it saves
            if not self.in_place:
                print(text, file=self.out, flush=True)
            else:
                print(f"\r\033[K{text}", end="\n" if done == total else "", file=self.out, flush=True)
