# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train --gpus N``: starts the same command once for each GPU, and splits environments and seeds."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from stripe_newton.rl.distributed import LAUNCHER, exchange, join, send_to_launcher, world

from .run_configs import Configs
from .shell_command import command
from .tasks import import_options
from .user_error import UserError

__all__ = ["launch_ranks", "number_of_ranks", "run_folder_of_all", "split_over_ranks"]


_RANKS_PER_CORE = 4
"""More would only wait for each other; without a bound a slip of the finger starts thousands."""


def number_of_ranks(given: str | None) -> int:
    """Number of processes that this one starts; 1 if it trains itself, alone or as one of several ranks.

    Args:
        given: The value of ``--gpus``.

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
    most = _RANKS_PER_CORE * (os.cpu_count() or 1)
    if wanted is not None and wanted > most:
        raise UserError(
            f"--gpus {given}: must be at most {most}, {_RANKS_PER_CORE} processes for each core of this host"
        )
    if there == 1:
        return wanted or 1
    # This process is a rank. The launcher gives ranks the same arguments, so `--gpus` then only repeats their number.
    if LAUNCHER not in os.environ and wanted not in (None, there):
        raise UserError(f"--gpus {given}: torchrun has started {there} processes; leave --gpus out")
    return 1


def launch_ranks(task: str, argv: Sequence[str], count: int, user_errors: Sequence[type[Exception]]) -> int:
    """Start ``train`` with the same arguments once for each GPU.

    Args:
        task: The task, for messages.
        argv: The arguments after ``train``.
        count: Number of processes.
        user_errors: Errors that are shown without a traceback.

    Returns:
        The exit code.
    """
    from stripe_newton.rl.distributed.launcher import launch  # here, as a single process does not need torch's launcher

    arguments = ["-m", "stripe_newton.cli", *import_options(), "train", *argv]
    code, folder = launch(arguments, count, user_errors)
    if code == 1 and folder is not None:
        again = command("train", task, "--gpus", str(count), "--resume", folder)
        print(f"to continue from the last checkpoint:\n  {again}", file=sys.stderr)
    return code


def split_over_ranks(configs: Configs) -> None:
    """Give this rank its part of the environments and a seed of its own; the scene is the same in all ranks.

    Raises:
        UserError: if the environments cannot be split evenly.
    """
    me = world()
    if me.size == 1:
        return
    env = configs.env
    total = env.scene.num_envs
    if total % me.size:
        near = max(1, round(total / me.size)) * me.size
        raise UserError(f"--num-envs: {total} environments cannot be split evenly over {me.size} processes; {near} can")
    # The shortcuts of `train` have set both.
    assert env.seed is not None
    assert env.sim.device is not None
    env.scene.num_envs = total // me.size
    env.seed += me.rank
    join(env.sim.device)


def run_folder_of_all(path: Path | None) -> Path:
    """The run folder of rank 0, in every rank; only rank 0 gives one."""
    found = Path(next(given for given in exchange(None if path is None else str(path)) if given is not None))
    send_to_launcher("run_folder", str(found))
    return found
