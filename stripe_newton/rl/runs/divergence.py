# SPDX-License-Identifier: Apache-2.0
"""Divergence: weights that are not finite, said with the iteration and the last checkpoint before them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import nn

from stripe_newton.rl.errors import CheckpointError, DivergedError

from .checkpoint import load_checkpoint
from .run_folder import RunFolder

__all__ = ["check_losses", "check_networks", "diverged", "is_of_environment", "nonfinite_parts"]

_STATES = ("actor_state_dict", "critic_state_dict", "student_state_dict")
"""Networks in a checkpoint."""


def nonfinite_parts(tensors: Mapping[str, torch.Tensor]) -> list[str]:
    """Names of the tensors that have values that are not finite."""
    floats = {name: tensor for name, tensor in tensors.items() if tensor.is_floating_point()}
    if not floats:
        return []
    # All results in one tensor, so that the host waits for the device once.
    finite = torch.stack([tensor.isfinite().all() for tensor in floats.values()]).tolist()
    return [name for name, good in zip(floats, finite, strict=True) if not good]


def check_networks(networks: Mapping[str, nn.Module], where: str, run: RunFolder | None) -> None:
    """Check that all weights of some networks are finite.

    Args:
        networks: The networks by name.
        where: Where they are, for the message: a checkpoint, or an iteration.
        run: The run that they are of, whose checkpoints are looked at.

    Raises:
        DivergedError: if they are not, with the last checkpoint in which they are.
    """
    for name, network in networks.items():
        wrong = nonfinite_parts(network.state_dict())
        if wrong:
            raise diverged(f"{where}: weights of the {name} are not finite ({', '.join(wrong[:3])})", run)


def check_losses(losses: Mapping[str, float], iteration: int, run: RunFolder | None) -> None:
    """Check that the losses of an iteration are finite, whose gradients have gone into the weights.

    Raises:
        DivergedError: if one is not.
    """
    wrong = [f"{name} is {value}" for name, value in losses.items() if not math.isfinite(value)]
    if wrong:
        raise diverged(f"iteration {iteration + 1}: the loss {', '.join(wrong)}", run)


def is_of_environment(error: Exception) -> bool:
    """Whether an error says that an environment returned NaN, which may have gone into the weights since.

    rsl_rl looks at each step, before any update: weights that are not finite then were so before the step.
    """
    return "environment returned NaN" in str(error)


def diverged(problem: str, run: RunFolder | None) -> DivergedError:
    """The error about a policy that has diverged, with the last sound checkpoint of its run."""
    sound = None if run is None else _find_sound(run)
    advice = "train again with a smaller agent.algorithm.learning_rate, or look at rewards and observations"
    if sound is None:
        return DivergedError(f"{problem}: the training has diverged; no checkpoint is from before; {advice}")
    return DivergedError(f"{problem}: the training has diverged; the last sound checkpoint is {sound}; {advice}")


def _find_sound(run: RunFolder) -> Path | None:
    """The newest checkpoint of a run that can be read and whose weights are finite."""
    for _, file in reversed(run.list_checkpoints()):
        try:
            data = load_checkpoint(file)
        except CheckpointError:
            continue
        if not any(nonfinite_parts(data[name]) for name in _STATES if name in data):
            return file
    return None
