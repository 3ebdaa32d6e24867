# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train TASK --sweep FILE``: runs a sweep, each run a process of its own."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from stripe_newton.rl.experiments.sweep_process import Slot
from stripe_newton.threads import PROCESSES

from .run_configs import Configs
from .shell_command import command
from .sweep_file import read_sweep_file
from .tasks import import_options
from .user_error import UserError

__all__ = ["SweepOptions", "child_command", "list_slots", "run_sweep"]

_JOBS_PER_CORE = 4
"""More runs at a time would only wait for each other."""
_USED_HERE = ("--sweep", "--jobs", "--device", "--log-dir", "--max-iterations", "--num-envs", "--final-video")
"""Options that the sweep itself uses. All others are passed on to its runs."""
_REFUSED = {
    "--seed": "the seeds are in the file, as 'seeds'",
    "--resume": "the same command continues a sweep",
    "--env.seed": "the seeds are in the file, as 'seeds'",
    "--agent.seed": "the seeds are in the file, as 'seeds'",
    "--env.sim.device": "use --device",
    "--gpus": "each run of a sweep has one GPU; --jobs says how many run at a time",
}


@dataclass
class SweepOptions:
    """Options of ``train`` that the sweep itself uses."""

    file: Path
    """The file of the sweep."""
    jobs: int | None
    """Runs at a time; None for one on each GPU, or one on the CPU."""
    device: str | None
    """Device of the runs."""
    log_dir: Path
    """Folder of the folders of experiments."""
    max_iterations: int | None
    """Iterations of each run; overrides the file."""
    num_envs: int | None
    """Environments of each run; overrides the file."""


def run_sweep(task: str, argv: Sequence[str], options: SweepOptions, configs: Configs) -> int:
    """Run a sweep.

    Args:
        task: The task.
        argv: The arguments after ``train``.
        options: Those of them that are for the sweep.
        configs: Configs of the task with the values of the arguments, checked.

    Returns:
        The exit code: 0, or 130 if it was stopped.

    Raises:
        UserError: if the file or the options are wrong, or no trial was completed.
    """
    if importlib.util.find_spec("optuna") is None:
        raise UserError("--sweep needs optuna: pip install 'stripe-newton[sweep]'")
    others = _others(argv, task)
    cfg, name = read_sweep_file(options.file, task, configs)
    cfg = dataclasses.replace(
        cfg,
        options=tuple(others),
        max_iterations=options.max_iterations or cfg.max_iterations,
        num_envs=options.num_envs or cfg.num_envs,
    )
    if cfg.num_envs is not None and "env.scene.num-envs" in cfg.spaces:
        raise UserError(f"{options.file}: env.scene.num-envs: is tried, but num_envs fixes it; leave one of them out")
    slots = list_slots(options.device, options.jobs)

    # Here, as they need optuna, which need not be installed.
    from stripe_newton.rl.experiments.sweep import Sweep
    from stripe_newton.rl.experiments.sweep_folder import SweepError
    from stripe_newton.rl.experiments.sweep_report import report

    folder = options.log_dir / (configs.need_agent().experiment_name or task) / f"sweep_{name}"
    try:
        sweep = Sweep(cfg, folder, slots, child_command(), show=_show)
    except SweepError as error:
        raise UserError(str(error)) from None
    _show(f"sweep folder: {folder}\n{cfg.trials} trials x {len(cfg.seeds)} seeds, {cfg.sampler}, on {_names(slots)}")
    try:
        complete = sweep.run()
        table, best = report(sweep.study, cfg, folder)
    except SweepError as error:
        raise UserError(f"{options.file}: objective: {error}") from None
    finally:
        sweep.close()
    print(f"\n{table}\n\nsweep folder: {folder}")
    if not complete:
        print("stopped; the same command continues")
        return 130
    if best is None:
        raise UserError(f"{folder}: no trial was completed; results.csv says why each of them was not")
    print(f"best parameters:\n  {command('train', *cfg.words(best))}")
    return 0


def child_command() -> list[str]:
    """The words that start ``train`` in another process, with the same tasks imported."""
    return [sys.executable, "-m", "stripe_newton.cli", *import_options(), "train"]


def list_slots(device: str | None, jobs: int | None) -> list[Slot]:
    """Slots for the runs: one on each GPU, or ``jobs`` on the CPU.

    Raises:
        UserError: if there are not so many GPUs.
    """
    if jobs is not None and jobs < 1:
        raise UserError(f"--jobs {jobs}: must be at least 1")
    most = _JOBS_PER_CORE * (os.cpu_count() or 1)
    if jobs is not None and jobs > most:
        raise UserError(f"--jobs {jobs}: must be at most {most}, {_JOBS_PER_CORE} for each core of this host")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if device == "cpu" or not count:
        return _cpu_slots(jobs or 1)
    # Each run sees one GPU alone, as its "cuda:0". The names are those that the user's own choice of GPUs gives.
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = visible.split(",")[:count] if visible else [str(number) for number in range(count)]
    if device is not None and ":" in device:
        names = [names[int(device.split(":")[1])]]
    if jobs is not None and jobs > len(names):
        raise UserError(f"--jobs {jobs}: a run has a GPU of its own, there are {len(names)}")
    return [Slot(f"GPU {name}", "cuda:0", {"CUDA_VISIBLE_DEVICES": name}) for name in names[:jobs]]


def _cpu_slots(jobs: int) -> list[Slot]:
    environ = {"CUDA_VISIBLE_DEVICES": "", PROCESSES: str(jobs)}
    return [Slot("the CPU" if jobs == 1 else f"CPU {number}", "cpu", environ) for number in range(jobs)]


def _others(argv: Sequence[str], task: str) -> list[str]:
    """The arguments that are passed on to the runs."""
    rest: list[str] = []
    words = iter(argv)
    for word in words:
        name, equals, _ = word.partition("=")
        name = name.replace("_", "-")
        if name in _REFUSED:
            raise UserError(f"{name}: cannot be given beside --sweep; {_REFUSED[name]}")
        if name in _USED_HERE:
            if not equals:
                next(words, None)
        elif word != task:
            rest.append(word)
    return rest


def _names(slots: Sequence[Slot]) -> str:
    return ", ".join(slot.name for slot in slots)


def _show(line: str) -> None:
    print(line, flush=True)
