# SPDX-License-Identifier: Apache-2.0
"""TrainingState: what rsl_rl's checkpoint leaves out, the state of environments, log and random generators."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, cast

import torch
import warp as wp
from rsl_rl.algorithms import PPO, Distillation
from rsl_rl.extensions import RandomNetworkDistillation

from stripe_newton.rl.distributed import gather
from stripe_newton.rl.errors import CheckpointError
from stripe_newton.rl.torch_vector_env import EnvState, TorchVectorEnv, rl_env_of
from stripe_newton.value_types import PositiveFloat, mismatches

from .checkpoint import RngState, from_bytes, get_rng_state, load_checkpoint, set_rng_state, to_bytes
from .run_logger import LoggerState

if TYPE_CHECKING:
    from stripe_newton.rl.runner import OnPolicyRunner

__all__ = [
    "TrainingState",
    "gather_state",
    "restore_normalization",
    "restore_progress",
    "restore_state",
    "set_learning_rate",
]

_PROGRESS_ARRAYS = ("step", "parameters", "int_parameters")
"""Arrays of the managers' context that belong to no single environment: the clock, and the parameters of the terms,
which curricula change."""


class RndState(TypedDict):
    """State of random network distillation beside its parameters."""

    update_counter: int
    discounted_average: torch.Tensor | None


class TrainingState(TypedDict, total=False):
    """State of a training, beside what rsl_rl's algorithm saves."""

    env: EnvState | None
    """State of the environment with its last observations; None if the environment keeps no state."""
    hidden: dict | None
    """Memory of each network by name; None if no network is recurrent."""
    last_hidden: tuple | None
    """Memory from which a distillation's next update starts."""
    learning_rate: PositiveFloat
    """The learning rate, which the adaptive schedule changes."""
    logger: LoggerState
    """Totals, returns and lengths of the log."""
    rnd: RndState | None
    """State of random network distillation, or None without it."""
    rng: RngState
    """Global random generators."""
    ranks: list[torch.Tensor]
    """States of the ranks after rank 0, each as a tensor of bytes."""


def gather_state(runner: OnPolicyRunner) -> TrainingState:
    """The state of a training. Several ranks call this together; only rank 0 gets the states of all."""
    state = _state(runner)
    if not runner.is_distributed:
        return state
    # As bytes, so that each rank's tensors keep their own device until that rank reads them again.
    # Rank 0 sends nothing to itself: its own state is in the checkpoint as it is.
    gathered = gather(to_bytes(state).numpy() if runner.gpu_global_rank else None)
    if gathered is None:
        return {}
    return {**state, "ranks": [torch.from_numpy(content) for content in gathered[1:]]}


def _state(runner: OnPolicyRunner) -> TrainingState:
    algorithm = runner.alg
    hidden = {name: network.get_hidden_state() for name, network in runner.networks.items()}
    return {
        "env": runner.env.get_state(),
        "hidden": hidden if any(state is not None for state in hidden.values()) else None,
        "last_hidden": algorithm.last_hidden_states if isinstance(algorithm, Distillation) else None,
        "learning_rate": float(algorithm.learning_rate),
        "logger": runner.logger.get_state(),
        "rnd": _get_rnd_state(algorithm.rnd) if isinstance(algorithm, PPO) else None,
        "rng": get_rng_state(runner.device),
    }


def restore_state(
    runner: OnPolicyRunner, state: TrainingState, path: str | os.PathLike, continue_episodes: bool
) -> None:
    """Put back what :func:`gather_state` returned.

    Args:
        runner: The runner.
        state: State from the checkpoint.
        path: Path of the checkpoint, for messages.
        continue_episodes: Whether environments go on in the middle of their episodes. If not, only their clock goes on.

    Raises:
        CheckpointError: if the state is that of another environment.
    """
    if wrong := list(mismatches(state, TrainingState, "stripe_newton")):
        raise CheckpointError(f"{path}: cannot be resumed: {'; '.join(wrong[:3])}")
    same_ranks = 1 + len(state.get("ranks", ())) == runner.gpu_world_size
    if not same_ranks:
        print(
            f"{path} is of {1 + len(state.get('ranks', ()))} processes, now there are {runner.gpu_world_size}: "
            "episodes start anew",
            file=sys.stderr,
        )
    elif runner.gpu_global_rank:
        state = _state_of_rank(state, runner)
    try:
        continued = _restore_env(runner, state, same_ranks, continue_episodes)
        _restore_learning(runner, state, continued)
        # Last, since what comes before draws random numbers. The generators go on where everything that draws from
        # them goes on; an environment that keeps no state does not count.
        if continued or (state["env"] is None and same_ranks):
            set_rng_state(state["rng"], runner.device)
    except KeyError as error:
        raise CheckpointError(f"{path}: lacks {error}, was it written by another version?") from None
    except (ValueError, RuntimeError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise CheckpointError(f"{path}: does not fit this environment: {error}") from error


def restore_progress(runner: OnPolicyRunner, steps: int) -> None:
    """Go on after a number of steps with the networks and the optimiser alone, which have been loaded.

    Episodes start anew, clocks of curricula go on, and the learning rate is the optimiser's.

    Args:
        runner: The runner.
        steps: Steps that each environment has made.
    """
    inner = rl_env_of(runner.env.unwrapped)
    if inner is not None:
        inner.common_step_counter = steps
        for name in _PROGRESS_ARRAYS[:1]:
            if name in inner.context.arrays:
                wp.to_torch(inner.context.arrays[name]).fill_(steps)
    if runner.agent_cfg.init_at_random_ep_len:
        lengths = runner.env.episode_length_buf
        runner.env.episode_length_buf = torch.randint_like(lengths, high=int(runner.env.max_episode_length))
    set_learning_rate(runner.alg, runner.alg.optimizer.param_groups[0]["lr"])


def _state_of_rank(state: TrainingState, runner: OnPolicyRunner) -> TrainingState:
    return cast(TrainingState, from_bytes(state["ranks"][runner.gpu_global_rank - 1], runner.device))


def _restore_env(runner: OnPolicyRunner, state: TrainingState, same_ranks: bool, continue_episodes: bool) -> bool:
    """Restore the environments. Returns whether their episodes go on where they were."""
    env, saved = runner.env, state["env"]
    if saved is not None and same_ranks and continue_episodes:
        env.set_state(saved)
        return True
    if saved is not None:
        _carry_progress(env.unwrapped, saved["env"], parameters=continue_episodes)
    else:
        print("the environment keeps no state: its episodes start anew", file=sys.stderr)
    # New episodes, so the reason for random lengths is there again.
    if runner.agent_cfg.init_at_random_ep_len:
        lengths = env.episode_length_buf
        env.episode_length_buf = torch.randint_like(lengths, high=int(env.max_episode_length))
    return False


def _restore_learning(runner: OnPolicyRunner, state: TrainingState, continued: bool) -> None:
    """Restore log, memory of the networks, learning rate and random network distillation."""
    algorithm = runner.alg
    runner.logger.set_state(state["logger"], episodes_go_on=continued)
    if continued and state["hidden"] is not None:
        for name, network in runner.networks.items():
            network.reset(hidden_state=state["hidden"][name])
        if state.get("last_hidden") is not None:
            algorithm.last_hidden_states = state["last_hidden"]
    set_learning_rate(algorithm, state["learning_rate"])
    if isinstance(algorithm, PPO) and algorithm.rnd is not None and state["rnd"] is not None:
        _set_rnd_state(algorithm.rnd, state["rnd"], continued)


def restore_normalization(env: TorchVectorEnv, checkpoint: Path) -> None:
    """Load the statistics by which the environment, rather than the network, normalises observations.

    Playing and evaluating need them, as they are part of what the policy reads.
    """
    inner = rl_env_of(env)
    arrays = {} if inner is None else inner.context.arrays
    wanted = [name for name in arrays if name.startswith("observations.") and ".normalization." in name]
    if not wanted:
        return
    state = load_checkpoint(checkpoint).get("stripe_newton") or {}
    saved = ((state.get("env") or {}).get("env") or {}).get("arrays", {})
    for name in wanted:
        value = saved.get(f"context.{name}")
        if value is not None and value.shape == wp.to_torch(arrays[name]).shape:
            with torch.no_grad():
                wp.to_torch(arrays[name]).copy_(value)
        elif name.endswith((".mean", ".var")):
            print(f"warning: {checkpoint} lacks {name}; that of a new environment is used", file=sys.stderr)


def set_learning_rate(algorithm: PPO | Distillation, value: float) -> None:
    """Set the learning rate of the algorithm and of its optimiser."""
    algorithm.learning_rate = value
    for group in algorithm.optimizer.param_groups:
        group["lr"] = value


@torch.inference_mode(False)
@torch.no_grad()
def _carry_progress(env: TorchVectorEnv, state: EnvState, parameters: bool) -> None:
    """Restore the step counts of curricula; with ``parameters`` also the weights and parameters that they changed."""
    inner = rl_env_of(env)
    if "step" not in state or inner is None:
        return
    inner.common_step_counter = state["step"]
    arrays = inner.context.arrays
    for name in _PROGRESS_ARRAYS if parameters else _PROGRESS_ARRAYS[:1]:
        value = state["arrays"].get(f"context.{name}")
        if value is not None and name in arrays and arrays[name].shape == tuple(value.shape):
            wp.to_torch(arrays[name]).copy_(value)


def _get_rnd_state(rnd: RandomNetworkDistillation | None) -> RndState | None:
    if rnd is None:
        return None
    average = rnd.reward_normalizer.disc_avg.avg if rnd.reward_normalization else None
    return {"update_counter": rnd.update_counter, "discounted_average": average}


def _set_rnd_state(rnd: RandomNetworkDistillation, state: RndState, episodes_go_on: bool) -> None:
    rnd.update_counter = state["update_counter"]
    # The average is over the running episodes and has a value for each environment.
    if rnd.reward_normalization and episodes_go_on:
        rnd.reward_normalizer.disc_avg.avg = state["discounted_average"]
