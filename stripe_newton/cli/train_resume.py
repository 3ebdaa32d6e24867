# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train --resume``: which changes of the config a run can go on with."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatch

from .user_error import UserError

__all__ = ["Changes", "check_changes", "differences"]

Changes = Mapping[str, tuple[object, object]]
"""Fields that changed: ``{path: (before, after)}``."""

_FREE = (
    "agent.max_iterations",
    "agent.save_interval",
    "agent.experiment_name",
    "agent.run_name",
    "agent.logger*",
    "agent.log_project",
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
"""Fields that may change without a message."""

_NETWORKS = (
    "agent.algorithm.class_name",
    "agent.algorithm.optimizer",
    "agent.algorithm.rnd_cfg*",
    "agent.algorithm.share_cnn_encoders",
)
"""Fields of the algorithm that its saved state depends on. Changes of its other fields are accepted with a message."""


def differences(before: Mapping[str, object], after: Mapping[str, object], path: str = "") -> Changes:
    """Fields of two nested configs that differ: ``{path: (before, after)}``; None where a config lacks the field."""
    found: dict[str, tuple[object, object]] = {}
    for name in dict.fromkeys([*before, *after]):
        one, other = before.get(name), after.get(name)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            found |= differences(one, other, f"{path}{name}.")
        elif one != other:
            found[f"{path}{name}"] = one, other
    return found


def check_changes(run: str | None, changes: Changes, allowed: bool) -> bool:
    """Report or reject changes since the saved run.

    Args:
        run: The run's folder, for messages.
        changes: The changes, from :func:`differences`.
        allowed: Whether ``--allow-changes`` accepts all changes.

    Returns:
        Whether the environment is unchanged, so that its episodes can go on.

    Raises:
        UserError: for changes of the environment or the networks that are not allowed.
    """
    reported = {path: pair for path, pair in changes.items() if not any(fnmatch(path, free) for free in _FREE)}
    refused = {path: pair for path, pair in reported.items() if not _is_learning(path)}
    if refused and not allowed:
        raise UserError(
            f"{run} cannot continue as it was, since these differ:\n{_lines(refused)}\n"
            "start a new run with them, or add --allow-changes True: episodes start anew if the environment is another,"
            " and the networks must still be of the same sizes"
        )
    if reported:
        print(f"from here on, in {run}:\n{_lines(reported)}")
    return not any(path.startswith("env.") for path in refused)


def _is_learning(path: str) -> bool:
    """Whether a field says how the policy learns, which may change in the middle of a run."""
    learning = path.startswith("agent.algorithm.") or path == "agent.num_steps_per_env"
    return learning and not any(fnmatch(path, name) for name in _NETWORKS)


def _lines(changes: Changes) -> str:
    return "\n".join(f"  {path}: was {before!r}, is {after!r}" for path, (before, after) in changes.items())
