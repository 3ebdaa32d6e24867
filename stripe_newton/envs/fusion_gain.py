# SPDX-License-Identifier: Apache-2.0
"""Fusion gain: time of a manager's terms in one kernel, compared with one kernel for each term."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from statistics import median

import warp as wp

from stripe_newton.configclass import is_config
from stripe_newton.fusion import FusedKernel, Plan, Stage
from stripe_newton.managers import ManagerBase
from stripe_newton.managers.manager_base import terms_of
from stripe_newton.sim.capture import capture_graph

from .manager_based_rl_env import ManagerBasedRLEnv
from .step_times import Clock

__all__ = ["fused_kernels", "fusion_gain", "launch_us", "term_configs"]


def fusion_gain(env: ManagerBasedRLEnv, rounds: int = 20) -> dict[str, dict[str, float]]:
    """Time the terms of each manager fused into one kernel, and in one kernel for each term.

    Both read the state of the same environment. On a GPU each is a CUDA graph of these kernels alone. Torch terms are
    left out. The kernels write outputs such as rewards, which the next step overwrites.

    Args:
        env: A manager-based environment.
        rounds: Number of measurements; the median is returned.

    Returns:
        For each manager, and for ``all`` of them in one kernel: ``terms``, and microseconds ``fused_us`` and
        ``apart_us``.
    """
    managers: list[ManagerBase] = [env.termination_manager, env.reward_manager, env.observation_manager]
    gain, every_fused, every_apart = {}, [], []
    for manager in managers:
        terms = list(term_configs(manager.cfg))
        fused = fused_kernels([manager], [manager.cfg])
        apart = [kernel for cfg in terms for kernel in fused_kernels([manager], [cfg])]
        gain[manager.name] = _compare(env.device, fused, apart, len(terms), rounds)
        every_fused.append(manager.cfg)
        every_apart += apart
    together = fused_kernels(managers, every_fused)
    gain["all"] = _compare(env.device, together, every_apart, len(every_apart), rounds)
    return gain


def term_configs(cfg: object) -> Iterable[dict[str, object]]:
    """Split the config of a manager into configs of one term each; terms of groups stay within their group."""
    for name, value in terms_of(cfg).items():
        if not is_config(value):
            continue
        if hasattr(value, "func"):
            yield {name: value}
            continue
        terms = [k for k, term in terms_of(value).items() if hasattr(term, "func")]
        for term in terms:  # the value is a group of terms
            group = copy.copy(value)
            for other in terms:
                if other != term:
                    setattr(group, other, None)
            yield {name: group}


def fused_kernels(managers: Sequence[ManagerBase], cfgs: Sequence[object]) -> list[FusedKernel]:
    """Fused kernels of managers of the same classes with other configs, as neighbours in a step.

    The kernels read and write the arrays that the given managers share with the environment. Arrays of a manager alone,
    such as the sums of its terms, are made anew.
    """
    stages = []
    for manager, cfg in zip(managers, cfgs, strict=True):
        context = copy.copy(manager.context)
        context.problems = []
        context.arrays = {k: v for k, v in context.arrays.items() if not k.startswith(f"{manager.name}.")}
        with wp.ScopedDevice(context.device):
            items = type(manager)(cfg, context).compute_items()  # type: ignore[attr-defined]
        if context.problems:
            raise ValueError("\n".join(context.problems))
        stages.append(Stage(manager.name, items))
    context = managers[0].context
    return Plan("gain", stages, context.scope, context.num_envs, context.device, use_graph=False).kernels


def launch_us(device: str, launches: list[Callable[[], None]], rounds: int = 20, repeats: int = 20) -> float:
    """Time of consecutive launches [us]: the median over ``rounds``, each the mean of ``repeats``."""
    clock = Clock(device)

    def launch_all(times: int = repeats) -> None:
        for _ in range(times):
            for launch in launches:
                launch()

    launch_all(1)
    run: Callable[[], None] = launch_all
    if clock.is_cuda:
        graph = capture_graph(device, launch_all)

        def run() -> None:
            wp.capture_launch(graph)

    found = []
    for _ in range(rounds):
        # The device is kept busy until all is queued, so that it never waits for the host; one run warms its caches.
        clock.hold(0.001)
        run()
        start = clock.mark()
        run()
        found.append(1e3 * clock.ms(start, clock.mark()) / repeats)
    return median(found)


def _compare(
    device: str, fused: list[FusedKernel], apart: list[FusedKernel], terms: int, rounds: int
) -> dict[str, float]:
    return {
        "terms": terms,
        "fused_us": launch_us(device, [k.launch for k in fused], rounds),
        "apart_us": launch_us(device, [k.launch for k in apart], rounds),
    }
