# SPDX-License-Identifier: Apache-2.0
"""Tasks of Isaac Lab under the dialect: runs each that is registered, trains it, and says which fail and why.

    python tools/checks/isaaclab_runs.py SOURCE [TASK ...] [--part NAME] [--import MODULE] [--steps N] [--train N]
        [--out FILE]

``SOURCE`` is the folder that holds ``isaaclab_tasks/`` and ``isaaclab_assets/``; ``TASK`` names tasks, by default all
whose config is in the folder ``manager_based`` or ``direct`` that ``--part`` names. With ``--import``, they are those
that a module of somebody's own project registers; the project's folder is in ``PYTHONPATH``. Each runs in a process of
its own, with random actions, and must give finite observations and rewards; then ``stripe-newton train TASK
--isaaclab`` runs for a few iterations. ``--out`` keeps the outcomes, one JSON object a line, and a later call goes on
where it stopped.
``tools/documentation/isaaclab_table.py`` makes tables of them.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import logging
import multiprocessing
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import gymnasium
import torch

import stripe_newton.isaaclab as dialect
from stripe_newton import cli
from stripe_newton.configclass import ConfigError, resolve_name
from stripe_newton.isaaclab.registration import adopt_tasks

TIME_LIMIT = 900.0
"""Longest run of one task, or of its training [s]."""
NO_AGENT = "Isaac Lab has no agent of rsl_rl for it"
"""Outcome of training a task that is registered without one."""


@dataclass
class Outcome:
    """One task: how far it got."""

    task: str
    """Its name."""
    file: str
    """The file of its config, below ``isaaclab_tasks``."""
    steps: str
    """``"ok"``, or why it does not run."""
    train: str = ""
    """``"ok"``, why it does not train, or nothing where that was not tried."""


def tasks_of(part: str) -> dict[str, str]:
    """Files of the registered tasks whose config is in a folder of ``isaaclab_tasks``, by task."""
    import isaaclab_tasks  # the dialect's import hook must be there first

    adopt_tasks()
    found = {}
    for task, spec in gymnasium.registry.items():
        where = str(spec.kwargs.get("env_cfg_entry_point", ""))
        if where.startswith(f"{isaaclab_tasks.__name__}.{part}."):
            found[task] = where.split(":")[0].split(".", 1)[1].replace(".", "/") + ".py"
    return dict(sorted(found.items(), key=lambda item: (item[1], item[0])))


def tasks_of_project(module: str) -> dict[str, str]:
    """Modules of the configs of all tasks that a module of a project registers when it is imported, by task."""
    before = set(gymnasium.registry)
    importlib.import_module(module)
    adopt_tasks()
    new = {task: gymnasium.spec(task) for task in set(gymnasium.registry) - before}
    configs = {task: str(spec.kwargs.get("env_cfg_entry_point", "")) for task, spec in new.items()}
    found = {task: config.split(":")[0] for task, config in configs.items() if not config.startswith("isaaclab_tasks.")}
    return dict(sorted(found.items()))


# ---- one task, in a process of its own


def run_task(task: str, num_envs: int, steps: int) -> None:
    """Step a task with random actions.

    Raises:
        RuntimeError: an observation or a reward is not finite.
    """
    spec = gymnasium.spec(task)
    entry = spec.kwargs["env_cfg_entry_point"]
    cfg = (resolve_name(entry) if isinstance(entry, str) else entry)()
    cfg.scene.num_envs = num_envs
    cfg.sim.device = "cpu"
    env = (resolve_name(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point)(cfg)
    env.reset(seed=0)
    torch.manual_seed(0)
    for step in range(steps):
        results = env.step(_random_action(env))
        for what, value in _tensors(results[:2], "observation, reward"):
            if not torch.isfinite(value).all():
                raise RuntimeError(f"{what} is not finite after {step + 1} steps")
    env.close()


def _random_action(env: Any) -> Any:
    """Actions in [-1, 1] or of a discrete space, by agent where there are several."""
    if hasattr(env, "possible_agents"):
        return {agent: _sample(env.action_spaces[agent], env.num_envs) for agent in env.possible_agents}
    return _sample(env.single_action_space, env.num_envs)


def _sample(space: gymnasium.Space[Any], num_envs: int) -> torch.Tensor:
    if isinstance(space, gymnasium.spaces.Discrete):
        return torch.randint(int(space.n), (num_envs, 1))
    if isinstance(space, gymnasium.spaces.MultiDiscrete):
        return torch.stack([torch.randint(int(count), (num_envs,)) for count in space.nvec], dim=-1)
    return 2.0 * torch.rand((num_envs, *(space.shape or ()))) - 1.0


def _tensors(value: Any, path: str) -> Iterator[tuple[str, torch.Tensor]]:
    if isinstance(value, torch.Tensor):
        yield path, value
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from _tensors(part, f"{path} '{key}'")
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from _tensors(part, path)


def train_task(task: str, num_envs: int, iterations: int) -> None:
    """Train a task by the command line's own function.

    Raises:
        RuntimeError: it fails, or keeps no checkpoint.
    """
    with tempfile.TemporaryDirectory() as folder:
        numbers = ["--num-envs", str(num_envs), "--max-iterations", str(iterations)]
        options = ["--isaaclab", "--device", "cpu", "--final-video", "False", "--log-dir", folder]
        told = io.StringIO()
        with contextlib.redirect_stderr(told):
            status = cli.main(["train", task, *numbers, *options])
        if status:
            raise RuntimeError(
                f"'stripe-newton train' ended with {status}: {told.getvalue().strip().splitlines()[-1:]}"
            )
        if not list(Path(folder).rglob("model_*.pt")):
            raise RuntimeError("no checkpoint was kept")


def in_process(function: Callable[..., None], *arguments: Any) -> str:
    """``"ok"`` if a function returns in a process of its own, which starts with what this one has imported, or why
    not."""
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_report, args=(send, function, arguments))
    process.start()
    send.close()
    process.join(TIME_LIMIT)
    if process.is_alive():
        process.kill()
        return f"took more than {TIME_LIMIT:g} s"
    return str(receive.recv()) if receive.poll() else f"the process ended with {process.exitcode}"


def _report(send: Connection, function: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        try:
            function(*arguments)
            text = "ok"
        except ConfigError as error:
            text = error.problems[0]
        except BaseException as error:  # whatever a task may raise, SystemExit of the command line among it
            text = f"{type(error).__name__}: {error}"
    send.send(" ".join(text.split()))


# ---- all tasks


def run_all(tasks: dict[str, str], num_envs: int, steps: int, iterations: int) -> Iterator[Outcome]:
    """Run tasks, and train those that run, one after the other."""
    for task, file in tasks.items():
        outcome = Outcome(task, file, in_process(run_task, task, num_envs, steps))
        if iterations and outcome.steps == "ok":
            has_agent = "rsl_rl_cfg_entry_point" in gymnasium.spec(task).kwargs
            outcome.train = in_process(train_task, task, num_envs, iterations) if has_agent else NO_AGENT
        yield outcome


# ---- command line


def main() -> int:
    """Run the check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("tasks", nargs="*")
    parser.add_argument("--part", default="manager_based")
    parser.add_argument("--import", dest="module", metavar="MODULE", help="module that registers a project's tasks")
    parser.add_argument("--num-envs", type=int, default=4)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--train", type=int, default=0, help="iterations; 0 trains nothing")
    parser.add_argument("--out", type=Path)
    args = parser.parse_intermixed_args()
    source = args.source.resolve()
    os.environ["ISAACLAB_SOURCE"] = str(source)
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
    dialect.install()
    known = tasks_of(args.part) if args.module is None else tasks_of_project(args.module)
    unknown = [task for task in args.tasks if task not in known]
    if unknown:
        parser.error(f"no such task in '{args.module or args.part}': {', '.join(unknown)}")
    done = kept_outcomes([args.out]) if args.out is not None and args.out.exists() else {}
    wanted = {task: file for task, file in known.items() if task in (args.tasks or known) and task not in done}
    failed = 0
    for outcome in run_all(wanted, args.num_envs, args.steps, args.train):
        failed += outcome.steps != "ok" or outcome.train not in ("ok", "", NO_AGENT)
        print(f"{outcome.task}  steps: {outcome.steps}  train: {outcome.train or '-'}", flush=True)
        if args.out is not None:
            with args.out.open("a") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
    return 1 if failed else 0


def kept_outcomes(files: Iterable[Path]) -> dict[str, Outcome]:
    """Outcomes by task that ``--out`` has written to files, the latest of each task."""
    outcomes = [Outcome(**json.loads(line)) for file in files for line in file.read_text().splitlines()]
    return {outcome.task: outcome for outcome in outcomes}


if __name__ == "__main__":
    sys.exit(main())
