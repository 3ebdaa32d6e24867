# SPDX-License-Identifier: Apache-2.0
"""What rsl_rl's checkpoint leaves out: the state of the environments, of the log, and of all random numbers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import warp as wp

from .checkpoint import from_bytes, get_rng_state, load_checkpoint, set_rng_state, to_bytes
from .distributed import gather
from .errors import CheckpointError
from .networks import networks_of

if TYPE_CHECKING:
    from .runner import OnPolicyRunner

__all__ = ["gather_state", "restore_state", "restore_statistics", "set_learning_rate"]

_OF_PROGRESS = ("step", "parameters", "int_parameters")
"""Arrays of the managers' context that belong to no single environment: the clock, and the numbers of the terms, which
curricula change."""


def gather_state(runner: OnPolicyRunner) -> dict[str, Any]:
    """The state of a training. Several ranks call this together; only rank 0 gets what the others have, as ``ranks``,
    a tensor of bytes for each."""
    state = _state(runner)
    if not runner.is_distributed:
        return state
    told = gather(to_bytes(state).numpy() if runner.gpu_global_rank else None)
    return {} if told is None else state | {"ranks": [torch.from_numpy(content) for content in told[1:]]}


def _state(runner: OnPolicyRunner) -> dict[str, Any]:
    alg: Any = runner.alg
    hidden = {name: network.get_hidden_state() for name, network in networks_of(alg).items()}
    return {
        "env": runner.env.get_state(),
        "hidden": hidden if any(state is not None for state in hidden.values()) else None,
        "last_hidden": getattr(alg, "last_hidden_states", None),  # from which a distillation's next update starts
        "learning_rate": float(alg.learning_rate),
        "logger": runner.logger.get_state(),
        "rnd": _get_rnd_state(getattr(alg, "rnd", None)),
        "rng": get_rng_state(runner.device),
    }


def restore_state(runner: OnPolicyRunner, state: dict[str, Any], path: Any, go_on: bool) -> None:
    """Put back what :func:`gather_state` gave; ``path`` is for messages.

    Args:
        runner: the runner.
        state: what the checkpoint has.
        path: of the checkpoint, for messages.
        go_on: whether environments go on in their episodes; else only their clock goes on.

    Raises:
        CheckpointError: if it is of another environment.
    """
    ranks = 1 + len(state.get("ranks", ()))
    if ranks != runner.gpu_world_size:
        print(
            f"{path} is of {ranks} processes, now there are {runner.gpu_world_size}: episodes start anew",
            file=sys.stderr,
        )
    elif runner.gpu_global_rank:
        state = from_bytes(state["ranks"][runner.gpu_global_rank - 1], runner.device)
    try:
        here = ranks == runner.gpu_world_size and go_on and state["env"] is not None
        if here:
            runner.env.set_state(state["env"])
        elif state["env"] is not None:
            _carry_progress(runner.env.unwrapped, state["env"]["env"], numbers=go_on)
        else:
            print("the environment keeps no state: its episodes start anew", file=sys.stderr)
        if not here and getattr(runner.agent_cfg, "init_at_random_ep_len", False):
            lengths = runner.env.episode_length_buf
            runner.env.episode_length_buf = torch.randint_like(lengths, high=int(runner.env.max_episode_length))
        runner.logger.set_state(state["logger"], episodes_go_on=here)
        if here and state["hidden"] is not None:
            for name, network in networks_of(runner.alg).items():
                network.reset(hidden_state=state["hidden"][name])
            if state.get("last_hidden") is not None:
                runner.alg.last_hidden_states = state["last_hidden"]
        set_learning_rate(runner.alg, state["learning_rate"])
        if getattr(runner.alg, "rnd", None) is not None:
            _set_rnd_state(runner.alg.rnd, state["rnd"], here)
        if here or (state["env"] is None and ranks == runner.gpu_world_size):
            set_rng_state(state["rng"], runner.device)
    except KeyError as error:
        raise CheckpointError(f"{path}: lacks {error}, was it written by another version?") from None
    except (ValueError, RuntimeError) as error:
        raise CheckpointError(f"{path}: does not fit this environment: {error}") from error


def restore_statistics(env: Any, checkpoint: Path) -> None:
    """Take over what the environment had gathered to normalise observations by, where it is not the network's part."""
    arrays = getattr(getattr(env, "context", None), "arrays", {})
    wanted = [name for name in arrays if name.startswith("observations.") and ".normalization." in name]
    if not wanted:
        return
    state = load_checkpoint(checkpoint).get("stripe_newton") or {}
    saved = ((state.get("env") or {}).get("env") or {}).get("arrays", {})
    for name in wanted:
        there = saved.get(f"context.{name}")
        if there is not None and there.shape == wp.to_torch(arrays[name]).shape:
            with torch.no_grad():
                wp.to_torch(arrays[name]).copy_(there)
        elif name.endswith((".mean", ".var")):
            print(f"warning: {checkpoint} lacks {name}; it is that of a new environment", file=sys.stderr)


def set_learning_rate(algorithm: Any, value: float) -> None:
    """Set the learning rate of the algorithm and of its optimizer."""
    algorithm.learning_rate = value
    for group in algorithm.optimizer.param_groups:
        if not isinstance(group["lr"], torch.Tensor):  # else it is the algorithm's own
            group["lr"] = value


@torch.inference_mode(False)
@torch.no_grad()
def _carry_progress(env: Any, state: dict[str, Any], numbers: bool) -> None:
    """Let curricula that count steps go on; with ``numbers`` also the weights and parameters that they have changed."""
    if "step" not in state or not hasattr(env, "common_step_counter"):
        return
    env.common_step_counter = state["step"]
    arrays = getattr(getattr(env, "context", None), "arrays", {})
    for name in _OF_PROGRESS if numbers else _OF_PROGRESS[:1]:
        value = state["arrays"].get(f"context.{name}")
        if value is not None and name in arrays and arrays[name].shape == tuple(value.shape):
            wp.to_torch(arrays[name]).copy_(value)


def _get_rnd_state(rnd: Any) -> dict[str, Any] | None:
    """What random network distillation keeps outside its parameters."""
    if rnd is None:
        return None
    average = rnd.reward_normalizer.disc_avg.avg if rnd.reward_normalization else None
    return {"update_counter": rnd.update_counter, "discounted_average": average}


def _set_rnd_state(rnd: Any, state: dict[str, Any], episodes_go_on: bool) -> None:
    rnd.update_counter = state["update_counter"]
    if rnd.reward_normalization and episodes_go_on:
        rnd.reward_normalizer.disc_avg.avg = state["discounted_average"]
