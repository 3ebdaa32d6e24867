# SPDX-License-Identifier: Apache-2.0
"""Learning loop over rollouts and updates that are graphs: the host launches them, and logs while the device works."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from .rollout import GraphRollout, Report

if TYPE_CHECKING:
    from stripe_newton.rl.runner import OnPolicyRunner

__all__ = ["learn_in_graphs"]


@dataclass
class _Iteration:
    """An iteration that was launched and is not logged yet."""

    number: int
    report: Callable[[], Report]
    collect_s: Callable[[], float]


def learn_in_graphs(runner: OnPolicyRunner, rollout: GraphRollout, first: int, total: int) -> None:
    """Train from iteration ``first`` up to, but without, iteration ``total``.

    On a GPU an iteration is logged while the device works on the next one. It is logged at once where the state after
    it is needed: for a checkpoint, a hook, a stop, or the end of the training.

    Raises:
        StopTraining: if the run was asked to stop; the last iteration is complete and logged then.
        ValueError: if the environment returned NaN and the config says to check for it.
    """
    algorithm, logger = runner.alg, runner.logger
    clock = _Clock(runner.device)
    waiting: _Iteration | None = None

    for number in range(first, total):
        clock.begin()
        obs = rollout.collect()
        clock.lap()
        algorithm.compute_returns(obs)
        losses = algorithm.update()
        numbers = losses | {"learning_rate": algorithm.rate, "std": algorithm.std}
        iteration = _Iteration(number, rollout.send_report(numbers), clock.reader())
        # The whole iteration is queued and the device is busy: now there is time for the log of the one before.
        if waiting is not None:
            logger.ahead = True
            _log(runner, waiting, clock, first, total)
            logger.ahead, waiting = False, None
        runner.current_learning_iteration = number
        saves = logger.writer is not None and number % runner.cfg["save_interval"] == 0
        observed = saves or logger.iteration_hooks or logger.stop_requested or number + 1 == total
        # Several ranks agree on a stop when they log, which must be before the next rollout begins. A CPU has done the
        # iteration by now: logged later, its time would count as that of the next one.
        if clock.is_cuda and not observed and not runner.is_distributed:
            waiting = iteration
            continue
        _log(runner, iteration, clock, first, total)
        if saves:
            runner.save(os.path.join(logger.log_dir, f"model_{number}.pt"))


def _log(runner: OnPolicyRunner, iteration: _Iteration, clock: _Clock, first: int, total: int) -> None:
    """Wait for the report of an iteration and log it."""
    logger = runner.logger
    # The one place of the loop where the host waits for the device.
    found = iteration.report()
    collect_s, whole_s = iteration.collect_s(), clock.since_last()
    if found.problem:
        raise ValueError(f"iteration {iteration.number}: {found.problem}; look at the task's terms")
    # rsl_rl's logger gathers these in each step, for which it waits for the device; here they come at once.
    logger.rewbuffer.extend(found.returns)
    logger.lenbuffer.extend(found.lengths)
    if logger.writer is not None and found.log:
        logger.ep_extras.append(found.log)
    rate, std = found.numbers.pop("learning_rate"), found.numbers.pop("std")
    logger.log(
        it=iteration.number,
        start_it=first,
        total_it=total,
        # The device's time for this rollout may be longer than the host's since the last log.
        collect_time=min(collect_s, whole_s),
        learn_time=max(whole_s - collect_s, 0.0),
        loss_dict=found.numbers,
        learning_rate=rate,
        action_std=torch.tensor(std),
        rnd_weight=None,
    )


class _Clock:
    """Times of an iteration: that of the rollout on the device, that of the whole iteration on the host."""

    def __init__(self, device: str):
        self.is_cuda = torch.device(device).type == "cuda"
        """Whether the device works on while the host goes on."""
        self._last = time.perf_counter()
        self._times: list[float] = []
        self._events: list[torch.cuda.Event] = []

    def begin(self) -> None:
        """Mark the begin of the rollout."""
        self._times, self._events = [], []
        self.lap()

    def lap(self) -> None:
        """Mark the end of the rollout."""
        self._times.append(time.perf_counter())
        if self.is_cuda:
            # The host only queues work, so its own clock says nothing about the device.
            event = torch.cuda.Event(enable_timing=True)
            event.record()
            self._events.append(event)

    def reader(self) -> Callable[[], float]:
        """A function that returns the duration of the rollout [s]; call it once the device has come to its end."""
        if not self.is_cuda:
            begin, end = self._times
            return lambda: end - begin
        first, last = self._events
        return lambda: first.elapsed_time(last) / 1.0e3

    def since_last(self) -> float:
        """Time since the last call on the host [s]."""
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        return seconds
