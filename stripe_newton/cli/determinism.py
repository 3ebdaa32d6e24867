# SPDX-License-Identifier: Apache-2.0
"""Determinism: ``--deterministic`` makes results the same bits again, and refuses what cannot be."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import torch

from stripe_newton.rl.distributed import world
from stripe_newton.rl.torch_vector_env import is_simulated

from .user_error import UserError

if TYPE_CHECKING:
    from stripe_newton.rl import RslRlVecEnvWrapper

__all__ = ["make_deterministic", "promise"]


def make_deterministic(device: str | None) -> None:
    """Let torch compute the same bits in every run; call it before anything is computed.

    An operation that torch cannot compute so, for example in a hook of the user's, is an error that names it.

    Raises:
        UserError: for a training with several processes.
    """
    if world().size > 1:
        raise UserError("--deterministic: not with --gpus or torchrun: sums over processes have no fixed order")
    # cuBLAS reads it when it is first used.
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True)
    torch.backends.cudnn.benchmark = False
    # Memory that is filled for safety would cost time, and every result is written before it is read.
    setattr(torch.utils.deterministic, "fill_uninitialized_memory", False)  # noqa: B010  (typed as read-only)
    if device == "cpu":
        # Sums are split over the threads, and machines have other numbers of them.
        torch.set_num_threads(1)


def promise(env: RslRlVecEnvWrapper) -> str:
    """Line that says what will be the same in every run with an environment.

    Raises:
        UserError: if its physics cannot be.
    """
    inner = env.unwrapped
    if not is_simulated(inner):
        return f"deterministic: networks; what {type(inner).__name__} computes is its own"
    from stripe_newton.solvers import SolverFused  # here, as it loads Newton, which --help does not need

    sim = inner.sim
    if sim.device != "cpu" and not sim.is_static:
        other = "its threads add forces and list contacts in no fixed order"
        reason = sim.solver.why_bits_vary() if isinstance(sim.solver, SolverFused) else other
        if reason:
            raise UserError(
                f"--deterministic: the physics is {sim.describe_solver()}; on a GPU {reason}. A model that the fused "
                "solver supports, or --device cpu, gives the same bits"
            )
    what = "the same bits in every run and after a resume"
    same = f"with this device, these versions, seed and {env.num_envs} environments"
    return f"deterministic: physics, sensors, rewards and networks give {what}, {same}"
