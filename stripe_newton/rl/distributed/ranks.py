# SPDX-License-Identifier: Apache-2.0
"""Ranks: the processes that train one policy together, their devices, and what they send each other.

The terms are torch's: the processes are ranks of a world, and rank 0 writes the files. They are started by
:mod:`stripe_newton.rl.distributed.launcher` or by ``torchrun``.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import TypeVar

import torch
import torch.distributed as dist

from stripe_newton.rl.errors import RanksError
from stripe_newton.rl.runs.interrupt import leave_terminal

__all__ = [
    "LAUNCHER",
    "LostRankError",
    "World",
    "as_rank",
    "exchange",
    "gather",
    "join",
    "rank_device",
    "send_to_launcher",
    "stop_asked",
    "world",
]

T = TypeVar("T")

LAUNCHER = "STRIPE_NEWTON_LAUNCHER"
"""Environment variable in which the launcher gives its ranks ``PROCESS:FOLDER``: its own process, and a folder for
messages between it and them."""

_TIMEOUT = "STRIPE_NEWTON_TIMEOUT_S"
"""Environment variable: how long a rank waits for the others [s]."""
_MOST_TIMEOUT = 1e7
"""Longest time of that [s], some months."""
_SECONDS_FOR_THE_CAUSE = 10.0
"""Time that a rank waits after it lost another one, before it fails itself."""


class LostRankError(RuntimeError):
    """Another rank has ended, or does not answer."""


@dataclass(frozen=True)
class World:
    """Number of this process among all that train together."""

    rank: int = 0
    """Index of the rank over all hosts, from 0."""
    local_rank: int = 0
    """Index of the rank on this host, from 0; also the number of its GPU."""
    size: int = 1
    """Number of processes."""


def world() -> World:
    """The world that ``torchrun`` or the launcher gives in environment variables; one process alone without them.

    Raises:
        RanksError: if the variables contradict each other, or are no numbers.
    """
    size = _variable("WORLD_SIZE", "1")
    if size == 1:
        return World()
    needed = ["RANK", "LOCAL_RANK"] + ([] if LAUNCHER in os.environ else ["MASTER_ADDR", "MASTER_PORT"])
    missing = [name for name in needed if name not in os.environ]
    if missing:
        raise RanksError(f"WORLD_SIZE is {size}, but {', '.join(missing)} not set: start the processes with torchrun")
    one = World(_variable("RANK"), _variable("LOCAL_RANK"), size)
    if not 0 <= one.rank < size or not 0 <= one.local_rank < size:
        raise RanksError(f"RANK {one.rank} and LOCAL_RANK {one.local_rank} must be below WORLD_SIZE {size}")
    return one


def _variable(name: str, default: str = "") -> int:
    """A number that is given by an environment variable."""
    text = os.environ.get(name, default)
    try:
        return int(text)
    except ValueError:
        must = "must be a whole number, as torchrun sets it; a process alone has none"
        raise RanksError(f"the environment variable {name} is {text!r}, {must}") from None


def rank_device(requested: str | None, configured: str | None) -> str:
    """Choose the device of this rank, for torch and Warp.

    Call it before anything is allocated: what allocates without naming a device would fill GPU 0 from every rank.

    Args:
        requested: ``"cpu"``, ``"cuda"``, or None.
        configured: Device in the task's config, of which only the kind counts.

    Returns:
        ``"cpu"`` or ``"cuda:LOCAL_RANK"``.

    Raises:
        ValueError: if there are fewer GPUs than ranks on this host, or one GPU is named for all.
    """
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if requested is not None and requested not in ("cpu", "cuda"):
        raise ValueError(f"--device {requested}: each rank has its own; choose GPUs by CUDA_VISIBLE_DEVICES")
    kind = requested or ("cpu" if configured == "cpu" else "cuda")
    local = world().local_rank
    if kind == "cuda" and local >= count:
        there = f"has {count} GPUs" if count else "has no GPU; --device cpu runs the processes on the CPU"
        raise ValueError(f"each process needs a GPU of its own; this is number {local + 1}, and the host {there}")
    if kind == "cpu":
        return "cpu"
    import warp as wp  # here, as runs on the CPU and single processes come by without it

    device = f"cuda:{local}"
    torch.cuda.set_device(local)
    wp.set_device(device)
    return device


def join(device: str) -> None:
    """Join the other ranks, once: by gloo for tensors on the CPU, by NCCL for those on GPUs.

    The launcher's ranks find each other by a file. Those of ``torchrun`` do so by the port of its first host.
    """
    if dist.is_initialized():
        return
    timeout = timedelta(seconds=_timeout())
    # Without a store torch reads rank and size from the environment variables of torchrun.
    me, store = World(-1, 0, -1), None
    if LAUNCHER in os.environ:
        me = world()
        store = dist.FileStore(str(_launcher_folder() / "store"), me.size)
    if torch.device(device).type == "cpu":
        dist.init_process_group("gloo", timeout=timeout, store=store, rank=me.rank, world_size=me.size)
    else:
        # gloo as well: `exchange` and `gather` send objects of the host.
        backends, on_gpu = "cpu:gloo,cuda:nccl", torch.device(device)
        dist.init_process_group(
            backends, timeout=timeout, store=store, rank=me.rank, world_size=me.size, device_id=on_gpu
        )


def _timeout() -> float:
    """How long this rank waits for the others [s].

    Raises:
        RanksError: if the environment variable for it is no such time.
    """
    text = os.environ.get(_TIMEOUT, "1800")
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds <= _MOST_TIMEOUT:  # not for NaN either
        raise RanksError(
            f"the environment variable {_TIMEOUT} is {text!r}, must be seconds, {_MOST_TIMEOUT:.0f} at most"
        )
    return seconds


def exchange(value: T) -> list[T]:
    """The values of all ranks, in the order of ranks. All ranks call this and wait for each other."""
    if not dist.is_initialized():
        return [value]
    values: list[T] = [value] * dist.get_world_size()
    dist.all_gather_object(values, value)
    return values


def gather(value: T) -> list[T] | None:
    """The values of all ranks in rank 0, and None in the others. All ranks call this."""
    if not dist.is_initialized():
        return [value]
    values: list[T] | None = [value] * dist.get_world_size() if dist.get_rank() == 0 else None
    dist.gather_object(value, values, dst=0)
    return values


def stop_asked() -> bool:
    """Whether the launcher was interrupted, or has ended."""
    if LAUNCHER not in os.environ:
        return False
    try:
        if (_launcher_folder() / "stop").read_text(encoding="utf-8") == "SIGHUP":
            leave_terminal()  # the signal itself goes to the launcher alone
    except OSError:
        return os.getppid() != int(os.environ[LAUNCHER].partition(":")[0])
    return True


def send_to_launcher(name: str, text: str) -> None:
    """Write a message for the launcher, if there is one and this is rank 0."""
    if LAUNCHER in os.environ and world().rank == 0:
        (_launcher_folder() / name).write_text(text, encoding="utf-8")


def _launcher_folder() -> Path:
    """Folder of the launcher that has started this rank."""
    return Path(os.environ[LAUNCHER].partition(":")[2])


def as_rank(function: Callable[[], int], user_errors: tuple[type[Exception], ...] = ()) -> int:
    """Run ``function`` as one rank.

    Ranks after rank 0 print nothing. An error ends the process at once, so that no other rank waits for it. The
    launcher shows the error, which it gets through torch's error file; under ``torchrun`` it is printed here.

    Args:
        function: The function; with one process alone it is simply called.
        user_errors: Errors that are shown without a traceback.

    Returns:
        The function's exit code.
    """
    me = world()
    if me.size == 1:
        return function()
    from torch.distributed.elastic.multiprocessing.errors import record  # here, as a single process does not need it

    if me.rank:
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (to the end of the process)
    try:
        result = record(lambda: _or_lost(function))()
    except Exception as error:
        if LAUNCHER not in os.environ:
            text = f"error: {error}" if isinstance(error, user_errors) else f"\n{traceback.format_exc()}"
            print(f"rank {me.rank}: {text}", file=sys.__stderr__)
        for stream in (sys.__stdout__, sys.__stderr__):
            if stream is not None:
                stream.flush()
        # Not `sys.exit`: Python's and NCCL's own ends may wait for the other ranks.
        os._exit(1)
    if dist.is_initialized():
        dist.destroy_process_group()
    return int(result or 0)


def _or_lost(function: Callable[[], int]) -> int:
    try:
        return function()
    except Exception as error:
        if not _is_of_another_rank(error):
            raise
        # The rank that failed first is the one to report. The launcher or torchrun ends this one when it sees that.
        time.sleep(_SECONDS_FOR_THE_CAUSE)
        lines = str(error).splitlines() or [type(error).__name__]
        raise LostRankError(f"rank {world().rank} got no answer from another rank: {lines[0][:200]}") from error


def _is_of_another_rank(error: Exception) -> bool:
    """Whether an error only says that another rank is gone."""
    # gloo raises plain RuntimeErrors; torch's own class is missing in some of its versions.
    kind = getattr(dist, "DistError", None)
    gloo = isinstance(error, RuntimeError) and any(
        sign in str(error) for sign in ("gloo", "onnection closed by peer", "onnection reset by peer")
    )
    return gloo or (kind is not None and isinstance(error, kind))
