# SPDX-License-Identifier: Apache-2.0
"""Sweep: trials of field values that optuna proposes, each seed of a trial a training in a process of its own."""

from __future__ import annotations

import contextlib
import math
import signal
import statistics
import threading
import time
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import optuna
from optuna.trial import TrialState

from stripe_newton.rl.runs.interrupt import leave_terminal

from .sweep_cfg import Scalar, Space, SweepCfg
from .sweep_folder import SweepError, lock_folder, open_study, write_cfg
from .sweep_process import Run, Slot, SweepProcess, mean_of_last
from .text_tables import format_number, short_names

__all__ = ["Sweep", "SweepError"]


@dataclass
class _OpenTrial:
    """A trial that is not finished."""

    trial: optuna.Trial
    params: dict[str, Scalar]
    """Value of each field."""
    waiting: list[Run]
    """Runs that have not started."""
    values: dict[int, float] = field(default_factory=dict)
    """Objective of the complete runs, by seed."""
    error: str | None = None
    """Reason of the failure."""
    pruned: bool = False
    """Whether the pruner has ended it."""
    reported: int = 0
    """Iterations that were reported to the pruner."""


class Sweep:
    """A sweep in a folder: ``sweep.yaml``, ``study.journal`` and ``trials/NUMBER/seed_SEED``, a run in each.

    The same sweep in the same folder continues: with trials that have not begun, and with interrupted runs from their
    checkpoints.
    """

    def __init__(
        self,
        cfg: SweepCfg,
        folder: Path,
        slots: Sequence[Slot],
        command: Sequence[str],
        show: Callable[[str], None] = print,
        poll_s: float = 1.0,
    ):
        """Open the study.

        Args:
            cfg: The sweep.
            folder: Its folder.
            slots: Places for processes, one process in each at a time.
            command: The words that start a training, to which the task and its options are added.
            show: Called with a line of text for each event.
            poll_s: Time from one look at the processes to the next [s].

        Raises:
            SweepError: if the folder contains another sweep, or one that is running.
        """
        self.cfg, self.folder, self.slots, self.command = cfg, Path(folder), list(slots), list(command)
        self.show, self.poll_s = show, poll_s
        self.open: list[_OpenTrial] = []
        self.running: list[tuple[_OpenTrial, SweepProcess]] = []
        self.stopping = False
        self._requests = 0
        self.folder.mkdir(parents=True, exist_ok=True)
        # Before the study is opened, which repairs the journal of a sweep that was killed.
        self._lock = lock_folder(self.folder, show)
        try:
            write_cfg(self.folder, cfg)
            self.study = open_study(self.folder, cfg, parallel=len(self.slots) > 1)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Unlock the folder."""
        self._lock.release()

    def run(self) -> bool:
        """Run all trials.

        Ctrl-C or SIGTERM is passed on to the runs, which save and end; a second one ends them at once.

        Returns:
            Whether all trials were done.

        Raises:
            SweepError: if the first run shows that the objective is not logged.
        """
        with self._on_signals():
            try:
                for frozen in self.study.get_trials(states=(TrialState.RUNNING,)):
                    # optuna has no public way back to a trial that an earlier process began.
                    self._begin(optuna.Trial(self.study, frozen._trial_id))
                while True:
                    self._start_processes()
                    if not self.running:
                        return not self.stopping
                    time.sleep(self.poll_s)
                    self._look()
            except BaseException:  # such as a full disk: the runs save
                self.interrupt()
                for _, process in self.running:
                    process.process.wait()
                raise

    def _look(self) -> None:
        """Handle signals, and processes that have ended."""
        while self._requests:
            self._requests -= 1
            how = "they end at once" if self.stopping else "they save and end (again: at once)"
            self.show(f"stopping {len(self.running)} runs: {how}")
            self.interrupt()
        for item in [item for item in self.running if item[1].ended()]:
            self.running.remove(item)
            item[1].close()
            self._after(*item)
        if self.cfg.pruner is not None:
            self._prune()

    def interrupt(self) -> None:
        """End all runs, as after Ctrl-C."""
        self.stopping = True
        for _, process in self.running:
            process.interrupt()

    # -- trials

    def _start_processes(self) -> None:
        while not self.stopping and len(self.running) < len(self.slots):
            # Seeds of open trials first, so that trials are completed early and the sampler learns from them.
            found = next((item for item in self.open if item.waiting), None)
            if found is None:
                if not self._has_more():
                    return
                self._begin(self.study.ask())
                continue
            self._start(found, found.waiting.pop(0))

    def _has_more(self) -> bool:
        # Waiting trials are those of a grid, enqueued when the study was opened.
        begun = self.study.get_trials(deepcopy=False)
        return sum(trial.state != TrialState.WAITING for trial in begun) < self.cfg.trials

    def _begin(self, trial: optuna.Trial) -> None:
        """Open a trial. Runs of it that an earlier process completed are not done again."""
        params = {name: _suggest(trial, name, space) for name, space in self.cfg.spaces.items()}
        place = self.folder / "trials" / f"{trial.number:04d}"
        runs = [Run(place / f"seed_{seed}", seed, self.cfg.max_iterations) for seed in self.cfg.seeds]
        steps = self.study.get_trials(deepcopy=False)[trial.number].intermediate_values
        item = _OpenTrial(trial, params, runs, reported=max(steps, default=0))
        self.open.append(item)
        # A copy of the list, since complete runs are taken out of it.
        for run in [run for run in runs if run.is_complete()]:
            item.waiting.remove(run)
            self._take_value(item, run)
        self._close_if_done(item)

    def _start(self, item: _OpenTrial, run: Run) -> None:
        used = [process.slot for _, process in self.running]
        slot = next(slot for slot in self.slots if slot not in used)
        more = run.resume_words()
        words = [*self.cfg.words(item.params), "--seed", str(run.seed), "--device", slot.device, *more]
        words += ["--log-dir", str(run.path), "--final-video", "False"]
        # The process inherits the lock of the folder, and holds it until it has saved.
        shared = [] if self._lock.descriptor is None else [self._lock.descriptor]
        self.running.append((item, SweepProcess(run, slot, [*self.command, *words], keep_open=shared)))
        names = short_names(self.cfg.varied)
        shown = ", ".join(f"{name} {format_number(item.params[field])}" for field, name in names.items())
        going_on = " goes on" if more else ""
        self.show(f"trial {item.trial.number}, seed {run.seed}{going_on} on {slot.name}" + (shown and f": {shown}"))

    def _after(self, item: _OpenTrial, process: SweepProcess) -> None:
        """Handle the end of a process."""
        error = process.error()
        if error is not None:
            self._give_up(item, error)
        elif process.run.is_complete():
            self._take_value(item, process.run)
        self._close_if_done(item)

    def _take_value(self, item: _OpenTrial, run: Run) -> None:
        value = run.value(self.cfg.objective, self.cfg.last)
        if math.isnan(value):
            columns, folder = run.columns(), run.folder()
            file = folder.metrics if folder is not None else run.path
            there = self.cfg.objective in columns
            what = "has no value in its last rows" if there else "is not a column"
            error = f"'{self.cfg.objective}' {what} of {file}; there are {', '.join(columns)}"
            if not there and not self.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
                raise SweepError(error)  # as it would be in all trials
            self._give_up(item, f"seed {run.seed}: {error}")
        item.values[run.seed] = value

    def _give_up(self, item: _OpenTrial, error: str) -> None:
        if item.error is None:
            item.error = error
            self.show(f"trial {item.trial.number} failed: {error}")
        self._drop(item)

    def _drop(self, item: _OpenTrial) -> None:
        item.waiting.clear()
        for other, process in self.running:
            # Once: a second Ctrl-C would end it without saving.
            if other is item and not process.interrupted:
                process.interrupt()

    def _close_if_done(self, item: _OpenTrial) -> None:
        """Report a trial to the study if all of its runs have ended."""
        if item not in self.open or item.waiting or any(other is item for other, _ in self.running):
            return
        number, values = item.trial.number, [item.values.get(seed, math.nan) for seed in self.cfg.seeds]
        if item.error is None and not item.pruned and any(map(math.isnan, values)):
            return  # interrupted: it continues another time
        self.open.remove(item)
        item.trial.set_user_attr("values", {str(seed): value for seed, value in item.values.items()})
        if item.error is not None:
            item.trial.set_user_attr("error", item.error)
            self.study.tell(number, state=TrialState.FAIL)
        elif item.pruned:
            self.study.tell(number, state=TrialState.PRUNED)
        else:
            self._complete(number, values)

    def _complete(self, number: int, values: list[float]) -> None:
        """Report the objective of a trial to the study."""
        score = statistics.fmean(values)
        self.study.tell(number, score)
        spread = f" ± {format_number(statistics.stdev(values), 3)}" if len(values) > 1 else ""
        best = self.study.best_trial
        self.show(
            f"trial {number} done: {self.cfg.objective} {format_number(score)}{spread}"
            f"  (best: trial {best.number}, {format_number(best.value)})"
        )

    def _prune(self) -> None:
        """Report the first seed's run of each trial, and end the trials that the pruner rejects.

        The first seed is the same in all trials, so that trials are compared by the same random numbers.
        """
        for item in self.open:
            if item.pruned or item.error or self.stopping:
                continue
            run = Run(self.folder / "trials" / f"{item.trial.number:04d}" / f"seed_{self.cfg.seeds[0]}", 0, 0)
            column = run.columns().get(self.cfg.objective, [])[:-1]  # the last row may be half written
            for step in range(item.reported + 1, len(column) + 1):
                value = mean_of_last(column[:step], self.cfg.last)
                item.reported = step
                if math.isnan(value):
                    continue
                item.trial.report(value, step)
                if item.trial.should_prune():
                    item.pruned = True
                    self.show(f"trial {item.trial.number} pruned after {step} iterations: {format_number(value)}")
                    self._drop(item)
                    break

    @contextlib.contextmanager
    def _on_signals(self) -> Iterator[None]:
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def handle(number: int, frame: types.FrameType | None) -> None:
            # Only noted: a handler runs between any two lines, also in the middle of optuna's writing.
            self._requests += 1
            if number == signal.SIGHUP:
                leave_terminal()
                signal.signal(number, signal.SIG_IGN)  # it may come twice, by the shell and by the system

        ends = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
        if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # under nohup
            ends.remove(signal.SIGHUP)
        # The thread that ends a stuck command (`cli.end_signals`) must not cut the runs' saving short.
        watching = signal.set_wakeup_fd(-1)
        previous = {number: signal.signal(number, handle) for number in ends}
        try:
            yield
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(watching)


def _suggest(trial: optuna.Trial, name: str, space: Space) -> Scalar:
    """The value of a field that optuna proposes."""
    if space.choices:
        return trial.suggest_categorical(name, space.choices)
    if space.integer:
        return trial.suggest_int(name, int(space.low), int(space.high), step=int(space.step or 1), log=space.log)
    return trial.suggest_float(name, space.low, space.high, step=space.step, log=space.log)
