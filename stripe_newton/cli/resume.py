# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train --resume``: which changes of the configuration a run can go on with."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatch
from typing import Any

from .errors import UserError

__all__ = ["check_changes", "differences"]

_FREE = (
    "agent.max_iterations",
    "agent.save_interval",
    "agent.experiment_name",
    "agent.run_name",
    "agent.logger*",
    "agent.check_for_nan",
    "agent.init_at_random_ep_len",
    "agent.regenerate_interval",
    "agent.runner",
    "agent.matmul_precision",
    "agent.torch_compile_mode",
    "agent.algorithm.grad_reduce_bucket_mb",
    "env.viewer.*",
    "env.sim.device",
    "env.sim.render_interval",
    "env.sim.use_cuda_graph",
    "env.sim.on_overflow",
)
"""Fields that a run goes on with, whatever they are."""

_NETWORKS = (
    "agent.algorithm.class_name",
    "agent.algorithm.optimizer",
    "agent.algorithm.rnd_cfg*",
    "agent.algorithm.share_cnn_encoders",
)
"""Fields of the algorithm that its state depends on; of the others a change is only told."""


def differences(before: Mapping[str, Any], after: Mapping[str, Any], path: str = "") -> dict[str, tuple[Any, Any]]:
    """Fields of two nested configs that are not the same: ``{path: (before, after)}``; None where one has no such."""
    found: dict[str, tuple[Any, Any]] = {}
    for name in dict.fromkeys([*before, *after]):
        one, other = before.get(name), after.get(name)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            found |= differences(one, other, f"{path}{name}.")
        elif one != other:
            found[f"{path}{name}"] = one, other
    return found


def check_changes(run: Any, changes: Mapping[str, tuple[Any, Any]], allowed: bool) -> bool:
    """Tell, or refuse, what is not as it was in the run that shall go on.

    Args:
        run: the run's folder, for messages.
        changes: what :func:`differences` found.
        allowed: whether all changes are wanted.

    Returns:
        Whether the environment is what it was, so that its episodes can go on.

    Raises:
        UserError: for changes of the environment or the networks that are not allowed.
    """
    told = {path: pair for path, pair in changes.items() if not any(fnmatch(path, free) for free in _FREE)}
    refused = {path: pair for path, pair in told.items() if not _is_learning(path)}
    if refused and not allowed:
        raise UserError(
            f"{run} cannot go on as it was, since these differ:\n{_lines(refused)}\n"
            "start a new run with them, or add --allow-changes True: episodes start anew if the environment is another,"
            " and the networks must still be of the same sizes"
        )
    if told:
        print(f"from here on, in {run}:\n{_lines(told)}")
    return not any(path.startswith("env.") for path in refused)


def _is_learning(path: str) -> bool:
    learning = path.startswith("agent.algorithm.") or path == "agent.num_steps_per_env"
    return learning and not any(fnmatch(path, name) for name in _NETWORKS)


def _lines(changes: Mapping[str, tuple[Any, Any]]) -> str:
    return "\n".join(f"  {path}: was {before!r}, is {after!r}" for path, (before, after) in changes.items())
