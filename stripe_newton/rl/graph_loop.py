# SPDX-License-Identifier: Apache-2.0
"""The learning loop over rollouts and updates that are graphs: the host only launches them, and logs meanwhile."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from .graph_rollout import GraphRollout, Report

if TYPE_CHECKING:
    from .runner import OnPolicyRunner

__all__ = ["learn_in_graphs"]


@dataclass
class _Iteration:
    number: int
    report: Callable[[], Report]
    collect_s: Callable[[], float]


def learn_in_graphs(runner: OnPolicyRunner, rollout: GraphRollout, first: int, total: int) -> None:
    """Train from iteration ``first`` to before ``total``.

    An iteration is logged while the device works on the next one, unless somebody wants to see the state that it left:
    a checkpoint, a hook, or the end.

    Raises:
        StopTraining: if the run was asked to stop; the last iteration is complete and logged then.
        ValueError: if the environment returned NaN and the config says to look.
    """
    algorithm, logger = runner.alg, runner.logger
    clock = _Clock(runner.device)
    waiting: _Iteration | None = None

    def log(iteration: _Iteration) -> None:
        found = iteration.report()
        collect_s, whole_s = iteration.collect_s(), clock.since_last()
        if found.problem:
            raise ValueError(f"iteration {iteration.number}: {found.problem}; look at the task's terms")
        logger.rewbuffer.extend(found.returns)
        logger.lenbuffer.extend(found.lengths)
        if logger.writer is not None and found.log:
            logger.ep_extras.append(found.log)
        rate, std = found.numbers.pop("learning_rate"), found.numbers.pop("std")
        logger.log(
            it=iteration.number,
            start_it=first,
            total_it=total,
            collect_time=min(collect_s, whole_s),
            learn_time=max(whole_s - collect_s, 0.0),
            loss_dict=found.numbers,
            learning_rate=rate,
            action_std=torch.tensor(std),
            rnd_weight=None,
        )

    for number in range(first, total):
        clock.begin()
        obs = rollout.collect()
        clock.lap()
        if waiting is not None:
            logger.ahead = True
            log(waiting)
            logger.ahead, waiting = False, None
        algorithm.compute_returns(obs)
        losses = algorithm.update()
        runner.current_learning_iteration = number
        numbers = losses | {"learning_rate": algorithm.rate, "std": algorithm.std}
        iteration = _Iteration(number, rollout.tell(numbers), clock.reader())
        saves = logger.writer is not None and number % runner.cfg["save_interval"] == 0
        seen = saves or logger.iteration_hooks or logger.stop_requested or number + 1 == total
        if not seen and not runner.is_distributed:  # where ranks must agree on a stop before the next rollout
            waiting = iteration
            continue
        log(iteration)
        if saves:
            runner.save(os.path.join(logger.log_dir, f"model_{number}.pt"))


class _Clock:
    """Seconds of the device for the rollout, and of the wall for whole iterations."""

    def __init__(self, device: Any):
        self._cuda = torch.device(device).type == "cuda"
        self._last = time.perf_counter()
        self._marks: list[Any] = []

    def _mark(self) -> Any:
        if not self._cuda:
            return time.perf_counter()
        event = torch.cuda.Event(enable_timing=True)
        event.record()
        return event

    def begin(self) -> None:
        self._marks = [self._mark()]

    def lap(self) -> None:
        self._marks.append(self._mark())

    def reader(self) -> Callable[[], float]:
        """What gives the seconds between :meth:`begin` and :meth:`lap` once the device has come there."""
        start, end = self._marks
        return lambda: start.elapsed_time(end) / 1.0e3 if self._cuda else end - start

    def since_last(self) -> float:
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        return seconds
