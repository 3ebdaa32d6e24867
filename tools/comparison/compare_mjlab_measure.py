# SPDX-License-Identifier: Apache-2.0
"""Measurement of an environment for ``compare_mjlab.py``: the same functions for both sides.

This also runs under mjlab's interpreter, so of this repository it imports only the file that counts CUDA calls, by its
path.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import importlib.util
import itertools
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

__all__ = ["Memory", "Side", "measure", "measure_steps", "measure_training", "measure_walk", "versions"]

Json = dict[str, Any]
"""Requests and results, which go from process to process as JSON."""
BLOCK = 32
"""Steps between two waits for the device."""
TRY_EVERY = 10
"""Iterations between two policies that are tested for walking."""
MAX_ERROR, MIN_UPRIGHT = 0.25, 0.95
"""A robot walks if its mean error of the velocity [m/s] and the share of episodes without a fall are within these."""
PACKAGES = ("mjlab", "stripe-newton", "newton", "mujoco", "mujoco-warp", "warp-lang", "rsl-rl-lib", "torch")


@dataclasses.dataclass
class Side:
    """Interface of an environment for the measurement."""

    device: str
    num_envs: int
    num_actions: int
    step: Callable[[torch.Tensor], object]
    """One environment step."""
    physics: Callable[[], object]
    """The physics of one environment step, as the framework runs it, from the present state and targets."""
    state: list[torch.Tensor]
    """State from which the physics starts: views of the simulation's memory."""
    targets: list[torch.Tensor]
    """Targets of the joints: views of the simulation's memory."""
    spread: Callable[[torch.Tensor], None]
    """Sets the numbers of steps done, int64 ``(num_envs,)``, so that episodes end at different times."""
    max_episode_length: int
    make_runner: Callable[[str], Any]
    """Makes an rsl_rl runner that writes to a folder."""
    velocity_error: Callable[[], torch.Tensor]
    """Errors of the robots' horizontal velocities [m/s], ``(num_envs,)``."""
    physics_by: str = ""
    """What computes the physics, if there are several ways."""


def measure(make: Callable[[], Side], request: Json) -> Json:
    """Build an environment and measure it.

    Args:
        make: Builds the environment.
        request: ``device``, ``parts`` (``"step"``, ``"train"``, ``"walk"``), ``steps``, ``train_iterations``, ``seed``,
            ``asked`` (time at which this process was started, by ``time.time()``).

    Returns:
        Milliseconds, MiB and counts a step for ``"step"``, see :func:`measure_steps`; for ``"train"`` the curve and its
        medians, see :func:`measure_training`; for ``"walk"`` also the first policy that walks, see
        :func:`measure_walk`. CUDA counts and memory are None on the CPU.
    """
    memory = Memory(request["device"])
    start = time.perf_counter()
    side = make()
    found: Json = {"versions": versions(), "device_name": device_name(side.device), "num_envs": side.num_envs}
    found["physics_by"] = side.physics_by
    wait(side.device)
    found["build_s"] = time.perf_counter() - start
    memory.look()
    if "step" in request["parts"]:
        found |= measure_steps(side, request["steps"], request["seed"], memory)
        found["memory_mb"] = memory.look()
    if "train" in request["parts"]:
        found["start_s"] = time.time() - request["asked"]
        runner, policies, curve = measure_training(side, request["train_iterations"])
        found |= curve
        found["train_memory_mb"] = memory.look()
        if "walk" in request["parts"]:
            found |= measure_walk(side, runner, policies, found["start_s"])
    return found


def measure_steps(side: Side, steps: int, seed: int, memory: Memory) -> Json:
    """Times of whole steps under uniform actions in [-1, 1], and of the physics of the same steps, block by block.

    Episodes are spread over their length first. ``step_ms`` is the median of the blocks, by the clock on the wall with
    a wait at the end of each block. ``physics_ms`` is a median too, with a wait at the end of each step, as the start
    state of each step is restored before it, which is not timed.
    """
    generator = torch.Generator(device=side.device).manual_seed(seed)
    shape = (min(BLOCK, steps), side.num_envs, side.num_actions)
    actions = 2.0 * torch.rand(shape, device=side.device, generator=generator) - 1.0
    lengths = torch.randint(side.max_episode_length, (side.num_envs,), device=side.device, generator=generator)
    side.step(actions[0])
    side.spread(lengths)
    for index in range(2 * len(actions)):  # robots fall and episodes end, as in a long run
        side.step(actions[index % len(actions)])
    memory.look()
    tape = []
    for action in actions:
        start = [array.clone() for array in side.state]
        side.step(action)
        tape.append((start, [array.clone() for array in side.targets]))
    side.physics()
    whole, physics = [], []
    for _ in range(max(1, round(steps / len(actions)))):
        wait(side.device)
        began = time.perf_counter()
        for action in actions:
            side.step(action)
        wait(side.device)
        whole.append(1e3 * (time.perf_counter() - began) / len(actions))
        physics.append(statistics.mean(timed_physics(side, *entry) for entry in tape))
    # recorded states must not count as memory of the training that follows
    del tape
    if side.device != "cpu":
        torch.cuda.empty_cache()
    found: Json = {
        "step_ms": statistics.median(whole),
        "step_range_ms": [min(whole), max(whole)],
        "physics_ms": statistics.median(physics),
        "physics_range_ms": [min(physics), max(physics)],
        "blocks": len(whole),
        "steps_in_block": len(actions),
        "env_steps_per_s": 1e3 * side.num_envs / statistics.median(whole),
    }
    kinds = ("graph_launches", "kernel_launches", "copies", "host_syncs", "kernels")
    counts: dict[str, float | None] = dict.fromkeys(kinds)
    if side.device != "cpu":
        counter = by_path("call_counts", Path(__file__).parents[2] / "stripe_newton" / "envs" / "call_counts.py")
        counts |= counter.count_calls(lambda index: side.step(actions[index]), len(actions))
    return found | {f"{kind}_per_step": count for kind, count in counts.items()}


def measure_training(side: Side, iterations: int) -> tuple[Any, list[Json], Json]:
    """Train with rsl_rl and record the values of its logger after each iteration.

    ``curve`` has a row for each iteration: samples so far, seconds since the start, mean return and length of the last
    100 episodes that ended (None before the first), seconds of collection and of learning. ``samples_per_s`` is that of
    the median iteration, so that the first one, in which kernels are loaded, does not count.

    Returns:
        The runner, the policies after every tenth iteration (``samples``, ``seconds``, ``state``), and the curve.
    """
    curve: list[Json] = []
    policies: list[Json] = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        wait(side.device)
        start = time.perf_counter()
        runner = side.make_runner(folder)
        logger, log = runner.logger, runner.logger.log
        samples = runner.cfg["num_steps_per_env"] * side.num_envs

        def note(*args: Any, **values: Any) -> None:
            log(*args, **values)
            seconds = time.perf_counter() - start
            curve.append(
                {
                    "samples": samples * (len(curve) + 1),
                    "seconds": seconds,
                    "return": statistics.mean(logger.rewbuffer) if logger.rewbuffer else None,
                    "length": statistics.mean(logger.lenbuffer) if logger.lenbuffer else None,
                    "collect_s": values["collect_time"],
                    "learn_s": values["learn_time"],
                }
            )
            if len(curve) % TRY_EVERY == 0:
                state = {name: value.clone() for name, value in runner.alg.actor.state_dict().items()}
                policies.append({"samples": curve[-1]["samples"], "seconds": seconds, "state": state})

        logger.log = note
        runner.learn(iterations, init_at_random_ep_len=True)
        wait(side.device)
    times = [row["seconds"] for row in curve]
    iteration = statistics.median(b - a for a, b in itertools.pairwise(times)) if len(times) > 1 else times[0]
    found = {
        "curve": curve,
        "samples_per_s": samples / iteration,
        "iteration_s": iteration,
        "collect_s": statistics.median(row["collect_s"] for row in curve),
        "learn_s": statistics.median(row["learn_s"] for row in curve),
    }
    return runner, policies, found


@torch.inference_mode()
def measure_walk(side: Side, runner: Any, policies: list[Json], start_s: float) -> Json:
    """Find the first policy that walks: each acts in its share of the environments, for one whole episode.

    Policies act without exploration noise, under the noise and the pushes of the training. A policy walks if the mean
    error of the velocity before a fall is less than 0.25 m/s, and 95 % of the robots do not fall.

    Returns:
        ``tried``, a row for each policy; ``walk_s``, seconds from the command, which was ``start_s`` before the
        training, to the first policy that walks; ``walk_samples``, its samples; None if no policy walks.
    """
    env, actor, count = runner.env, runner.alg.actor.eval(), len(policies)
    obs = env.reset()
    obs = obs[0] if isinstance(obs, tuple) else obs
    shares = [rows.to(side.device) for rows in torch.arange(side.num_envs).tensor_split(count)] if count else []
    upright = torch.ones(side.num_envs, dtype=torch.bool, device=side.device)
    error, steps = torch.zeros((2, side.num_envs), device=side.device)
    for _ in range(side.max_episode_length - 1 if count else 0):
        given = zip(policies, shares, strict=True)
        actions = [torch.func.functional_call(actor, policy["state"], (obs[rows],)) for policy, rows in given]
        obs, _, done, _ = env.step(torch.cat(actions))
        upright &= done == 0
        error += torch.where(upright, side.velocity_error(), 0.0)
        steps += upright
    tried: list[Json] = []
    for policy, rows in zip(policies, shares, strict=True):
        off, share = float((error / steps.clamp(min=1.0))[rows].mean()), float(upright[rows].float().mean())
        walks = off < MAX_ERROR and share >= MIN_UPRIGHT
        times = {"samples": policy["samples"], "seconds": start_s + policy["seconds"]}
        tried.append({**times, "velocity_error": off, "upright": share, "walks": walks})
    first = next((row for row in tried if row["walks"]), {"seconds": None, "samples": None})
    return {"tried": tried, "walk_s": first["seconds"], "walk_samples": first["samples"]}


class Memory:
    """Largest device memory in use since this object was made [MiB]; None on the CPU.

    Other programs on the device count too. Both allocators keep their memory, so looking now and then is enough.
    """

    def __init__(self, device: str):
        self._device, self._most = device, 0.0
        self._before = self._used()

    def look(self) -> float | None:
        """Look once more; return the largest memory in use so far [MiB]."""
        if self._device == "cpu":
            return None
        self._most = max(self._most, self._used() - self._before)
        return self._most

    def _used(self) -> float:
        if self._device == "cpu":
            return 0.0
        free, total = torch.cuda.mem_get_info(self._device)
        return (total - free) / 2**20


def timed_physics(side: Side, state: list[torch.Tensor], targets: list[torch.Tensor]) -> float:
    """Milliseconds of the physics of one environment step from a state."""
    for array, value in zip([*side.state, *side.targets], [*state, *targets], strict=True):
        array.copy_(value)
    wait(side.device)
    start = time.perf_counter()
    side.physics()
    wait(side.device)
    return 1e3 * (time.perf_counter() - start)


def wait(device: str) -> None:
    """Wait until the device has done all its work."""
    if device != "cpu":
        torch.cuda.synchronize(device)


def device_name(device: str) -> str | None:
    """Name of the GPU; None for the CPU."""
    return None if device == "cpu" else torch.cuda.get_device_name(device)


def versions() -> dict[str, str]:
    """Versions of the relevant packages that are installed."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def by_path(name: str, path: Path) -> ModuleType:
    """Import a module from a file."""
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot import {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
