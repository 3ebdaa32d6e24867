# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train --gpus N``: the same command once for each GPU, and what differs between them."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from stripe_newton.rl.distributed import LAUNCHER, exchange, join, tell, world

from .errors import UserError
from .tasks import import_options

__all__ = ["launch_ranks", "number_of_ranks", "run_folder_of_all", "split_over_ranks"]


def number_of_ranks(given: str | None) -> int:
    """How many processes ``--gpus`` asks this one to start: 1 if it is itself one of several, which train.

    Raises:
        UserError: if it is no number, or contradicts ``torchrun``.
    """
    try:
        there, wanted = world().size, None if given is None else int(given)
    except ValueError as error:
        message = f"--gpus {given}: must be a whole number" if str(given) in str(error) else str(error)
        raise UserError(message) from None
    if wanted is not None and wanted < 1:
        raise UserError(f"--gpus {given}: must be at least 1")
    if there == 1:
        return wanted or 1
    if LAUNCHER not in os.environ and wanted not in (None, there):
        raise UserError(f"--gpus {given}: torchrun has started {there} processes; leave --gpus out")
    return 1


def launch_ranks(task: str, argv: list[str], count: int) -> int:
    """Start ``train`` with the same words once for each GPU; returns the exit code."""
    from stripe_newton.rl.launcher import launch

    from . import USER_ERRORS
    from .common import command

    arguments = ["-m", "stripe_newton.cli", *import_options(), "train", *argv]
    code, folder = launch(arguments, count, USER_ERRORS)
    if code == 1 and folder is not None:
        again = command("train", task, "--gpus", str(count), "--resume", folder)
        print(f"after its last checkpoint the run goes on with:\n  {again}", file=sys.stderr)
    return code


def split_over_ranks(configs: Any) -> None:
    """Give this rank its part of the environments, and seeds of its own; the scene is the same in all.

    Raises:
        UserError: if the environments cannot be split evenly.
    """
    me = world()
    if me.size == 1:
        return
    total = configs.env.scene.num_envs
    if total % me.size:
        near = max(1, round(total / me.size)) * me.size
        raise UserError(f"{total} environments cannot be split evenly over {me.size} processes; {near} can")
    configs.env.scene.num_envs = total // me.size
    configs.env.seed += me.rank
    join(configs.env.sim.device)


def run_folder_of_all(path: Path | None) -> Path:
    """The run folder of rank 0, in every rank; only rank 0 gives one."""
    found = Path(next(given for given in exchange(None if path is None else str(path)) if given is not None))
    tell("run_folder", str(found))
    return found
