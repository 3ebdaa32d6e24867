# SPDX-License-Identifier: Apache-2.0
"""Several processes that train one policy, one a GPU: who this one is, its device, and what they tell each other.

The words are torch's: the processes are ranks of a world; rank 0 writes the files. They are started by
:mod:`stripe_newton.rl.launcher` or by ``torchrun``.
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
from typing import Any

import torch
import torch.distributed as dist

__all__ = [
    "LAUNCHER",
    "LostRankError",
    "World",
    "as_rank",
    "exchange",
    "gather",
    "join",
    "rank_device",
    "stop_asked",
    "tell",
    "world",
]

LAUNCHER = "STRIPE_NEWTON_LAUNCHER"
"""Environment variable in which the launcher tells its ranks ``PROCESS:FOLDER``, where they meet."""

_TIMEOUT = "STRIPE_NEWTON_TIMEOUT_S"
_SECONDS_FOR_THE_CAUSE = 10.0


class LostRankError(RuntimeError):
    """Another rank is gone, or does not answer."""


@dataclass(frozen=True)
class World:
    """Which of how many processes this one is."""

    rank: int = 0
    """From 0, over all hosts."""
    local_rank: int = 0
    """From 0, on this host; also the number of its GPU."""
    size: int = 1
    """Number of processes."""


def world() -> World:
    """What ``torchrun`` or the launcher says in the environment; one process alone otherwise.

    Raises:
        ValueError: if that contradicts itself.
    """
    size = int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        return World()
    missing = [name for name in ("RANK", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT") if name not in os.environ]
    if missing:
        raise ValueError(f"WORLD_SIZE is {size}, but {', '.join(missing)} not set: start the processes with torchrun")
    one = World(int(os.environ["RANK"]), int(os.environ["LOCAL_RANK"]), size)
    if not 0 <= one.rank < size or not 0 <= one.local_rank < size:
        raise ValueError(f"RANK {one.rank} and LOCAL_RANK {one.local_rank} must be below WORLD_SIZE {size}")
    return one


def rank_device(requested: str | None, configured: str | None) -> str:
    """Choose the device of this rank, for torch and Warp, before anything is allocated on another one.

    Args:
        requested: ``"cpu"``, ``"cuda"``, or None.
        configured: the device of the task's config, of which only the kind counts.

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
    import warp as wp

    device = f"cuda:{local}"
    torch.cuda.set_device(local)
    wp.set_device(device)
    return device


def join(device: str) -> None:
    """Meet the other ranks, once: gloo for what is on the CPU, NCCL for what is on GPUs."""
    if dist.is_initialized():
        return
    timeout = timedelta(seconds=float(os.environ.get(_TIMEOUT, "1800")))
    if torch.device(device).type == "cpu":
        dist.init_process_group("gloo", timeout=timeout)
    else:
        dist.init_process_group("cpu:gloo,cuda:nccl", timeout=timeout, device_id=torch.device(device))


def exchange(value: Any) -> list[Any]:
    """What every rank gave, in the order of ranks; all ranks call this, and wait for each other."""
    if not dist.is_initialized():
        return [value]
    values: list[Any] = [None] * dist.get_world_size()
    dist.all_gather_object(values, value)
    return values


def gather(value: Any) -> list[Any] | None:
    """What every rank gave, in rank 0, and None in the others; all ranks call this."""
    if not dist.is_initialized():
        return [value]
    values: list[Any] | None = [None] * dist.get_world_size() if dist.get_rank() == 0 else None
    dist.gather_object(value, values, dst=0)
    return values


def stop_asked() -> bool:
    """Whether the launcher was interrupted, or is gone."""
    if LAUNCHER not in os.environ:
        return False
    process, folder = os.environ[LAUNCHER].split(":", 1)
    return os.getppid() != int(process) or (Path(folder) / "stop").exists()


def tell(name: str, text: str) -> None:
    """Leave the launcher a note, if there is one and this is rank 0."""
    if LAUNCHER in os.environ and world().rank == 0:
        (Path(os.environ[LAUNCHER].split(":", 1)[1]) / name).write_text(text, encoding="utf-8")


def as_rank(function: Callable[[], int], user_errors: tuple[type[Exception], ...] = ()) -> int:
    """Run ``function`` as one rank: others than rank 0 are silent, and an error ends the process at once, so that no
    other waits for it. The error is told by the launcher, which torch's error file hands it to, else here.

    Args:
        function: what to run.
        user_errors: errors that are told without a traceback.

    Returns:
        What ``function`` does; with one process alone nothing else is done.
    """
    me = world()
    if me.size == 1:
        return function()
    from torch.distributed.elastic.multiprocessing.errors import record

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
        time.sleep(_SECONDS_FOR_THE_CAUSE)  # whoever started the ranks ends this one when it sees which one died
        lines = str(error).splitlines() or [type(error).__name__]
        raise LostRankError(f"rank {world().rank} got no answer from another rank: {lines[0][:200]}") from error


def _is_of_another_rank(error: Exception) -> bool:
    kind = getattr(dist, "DistError", None)
    gloo = isinstance(error, RuntimeError) and any(
        sign in str(error) for sign in ("gloo", "onnection closed by peer", "onnection reset by peer")
    )
    return gloo or (kind is not None and isinstance(error, kind))
