# SPDX-License-Identifier: Apache-2.0
"""Benchmark of a task: times of start-up and step, CUDA calls, memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import torch
import warp as wp
from gymnasium.vector import VectorEnv

from .call_counts import count_calls
from .rl_env import RLEnv
from .step_times import LEAD, Clock, measure_step

__all__ = ["benchmark", "binary_count", "random_actions", "timed_start"]

COUNTED = 64
"""Steps whose CUDA calls are counted."""


def random_actions(env: RLEnv, steps: int, seed: int = 0) -> torch.Tensor:
    """Uniform random actions in [-1, 1], shape ``(steps, num_envs, *action_shape)``, drawn on the device.

    Raises:
        ValueError: if the actions are not real numbers.
    """
    shape, kind = env.action_space.shape, env.action_space.dtype
    if shape is None or kind is None or not str(kind).startswith("float"):
        raise ValueError(f"action space {env.action_space}: only real actions can be measured")
    generator = torch.Generator(device=env.device).manual_seed(seed)
    return 2.0 * torch.rand((steps, *shape), device=env.device, generator=generator) - 1.0


def timed_start(make: Callable[[], VectorEnv], seed: int = 0) -> tuple[RLEnv, dict[str, float]]:
    """Build an environment, reset it and take one step, each timed.

    Returns:
        The environment without wrappers, and its figures: ``build_s``, ``reset_s`` and ``first_step_s`` [s], of which
        the last includes loading kernels and recording graphs; ``binaries_compiled``, the number of files that were
        added to Warp's kernel cache.
    """
    binaries, start = binary_count(), time.perf_counter()
    env = make().unwrapped
    clock = Clock(env.sim.device)
    begun: dict[str, float] = {"build_s": _since(start, clock)}
    try:
        action = random_actions(env, 1, seed)[0]
        clock.wait()
        start = time.perf_counter()
        env.reset(seed=seed)
        begun["reset_s"] = _since(start, clock)
        start = time.perf_counter()
        env.step(action)
        begun["first_step_s"] = _since(start, clock)
    except BaseException:
        env.close()
        raise
    return env, {**begun, "binaries_compiled": binary_count() - binaries}


def benchmark(make: Callable[[], VectorEnv], steps: int = 320, seed: int = 0, warmup: int = 128) -> dict[str, Any]:
    """Build an environment, measure it, close it.

    Environments first get random episode lengths, so that resets are spread over the steps as in a long run.

    Args:
        make: Returns the environment.
        steps: Steps to time, in blocks of up to 32.
        seed: Seed of the actions.
        warmup: Steps between the timed start and the timed steps.

    Returns:
        Figures ready for JSON: those of :func:`timed_start` and :class:`StepTimes`, the size of the environment, the
        device, and CUDA calls for each step, which are None on the CPU.
    """
    env, begun = timed_start(make, seed)
    try:
        clock, block = Clock(env.sim.device), min(32, steps)
        actions = random_actions(env, LEAD + block, seed)
        generator = torch.Generator(device=env.device).manual_seed(seed)
        phases = torch.randint(
            env.max_episode_length, env.episode_length_buf.shape, generator=generator, device=env.device
        )
        env.episode_length_buf = phases
        for index in range(max(warmup, 4)):
            env.step(actions[index % len(actions)])
        times = measure_step(env, actions, max(1, round(steps / block))).to_dict()
        calls: dict[str, float | None] = dict.fromkeys(
            ("graph_launches", "kernel_launches", "copies", "host_syncs", "kernels")
        )
        if clock.is_cuda:
            calls |= count_calls(lambda index: env.step(actions[index % len(actions)]), COUNTED)
        return {
            "device": env.sim.device,
            "device_name": torch.cuda.get_device_name(env.sim.device) if clock.is_cuda else None,
            "num_envs": env.num_envs,
            "decimation": env.cfg.decimation,
            "step_dt": env.step_dt,
            **times,
            "env_steps_per_s": 1e3 * env.num_envs / float(str(times["env_wall_ms"])),
            **{f"{kind}_per_step": count for kind, count in calls.items()},
            **begun,
            "device_memory_mb": _memory_mb(env.sim.device),
        }
    finally:
        env.close()


def binary_count() -> int:
    """Number of compiled binaries in Warp's kernel cache."""
    wp.init()
    endings = (".o", ".cubin", ".ptx", ".fatbin")
    return sum(name.endswith(endings) for _, _, names in os.walk(wp.config.kernel_cache_dir) for name in names)


def _since(start: float, clock: Clock) -> float:
    clock.wait()
    return time.perf_counter() - start


def _memory_mb(device: str) -> float | None:
    """Memory in use on a GPU by all processes [MiB]; None for the CPU."""
    if device == "cpu":
        return None
    free, total = torch.cuda.mem_get_info(device)
    return (total - free) / 2**20
