# SPDX-License-Identifier: Apache-2.0
"""Device and seeds of a command."""

from __future__ import annotations

import random
import sys
from typing import TYPE_CHECKING

import numpy as np
import torch

from stripe_newton.rl.distributed import rank_device, world
from stripe_newton.threads import choose_threads

from .user_error import UserError

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnvCfg

__all__ = ["set_device", "set_seeds"]


def set_device(env_cfg: RLEnvCfg, requested: str | None) -> None:
    """Write the device to run on into ``env_cfg``.

    It is the requested one, or else the configured one, the first GPU, or the CPU. Where several processes train
    together, it is the one of this rank. Torch computes on one thread from here on: environments compute nothing large
    on the CPU, and whoever makes networks chooses anew.

    Args:
        env_cfg: Config of the environment.
        requested: ``"cpu"``, ``"cuda"``, ``"cuda:N"``, or None.

    Raises:
        UserError: if the requested device is not there.
    """
    choose_threads(0.0)
    if world().size > 1:
        try:
            env_cfg.sim.device = rank_device(requested, env_cfg.sim.device)
        except ValueError as error:
            raise UserError(str(error)) from None
        return
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    devices = ["cpu", *(f"cuda:{index}" for index in range(count))]
    requested, configured = _numbered(requested), _numbered(env_cfg.sim.device)
    if requested is not None and requested not in devices:
        raise UserError(f"--device {requested}: there is no such device, this machine has {', '.join(devices)}")
    default = "cuda:0" if count else "cpu"
    if requested is None and configured is not None and configured not in devices:
        print(f"the configured device {configured} is not there, using {default}", file=sys.stderr)
        configured = None
    env_cfg.sim.device = requested or configured or default


def _numbered(device: str | None) -> str | None:
    """The device with its number: ``"cuda"`` is the first GPU."""
    return "cuda:0" if device == "cuda" else device


def set_seeds(seed: int) -> None:
    """Seed Python, NumPy and torch."""
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002 (user code may draw from the global generator)
    torch.manual_seed(seed)
