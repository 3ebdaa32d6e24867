# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton bench``: measures what a step of a task costs, and how much of it is physics."""

from __future__ import annotations

import json as json_module
import sys
import time
from typing import TYPE_CHECKING, Any

from . import BEGAN
from .arguments import parse, task_of
from .compile_log import CompileLog
from .device import set_device, set_seeds
from .kernel_warmup import warm_up
from .options import BenchArgs
from .run_configs import Configs, check, load_configs
from .tasks import make_env
from .user_error import check_count
from .written_places import try_place, write_result

if TYPE_CHECKING:
    from stripe_newton.rl.torch_vector_env import TorchVectorEnv

__all__ = ["BenchArgs", "measure", "run", "table"]


def run(argv: list[str]) -> int:
    """Run the command."""
    task = task_of(argv, "bench", BenchArgs)
    configs = load_configs(task, None, agent=False)
    args = parse(BenchArgs, argv, "bench", env=configs.env)
    check_count("--steps", args.steps)
    try_place("--json", args.json)
    imports = time.perf_counter() - BEGAN
    result = measure(configs, args)
    result["import_s"] = imports
    result["ready_s"] = imports + sum(result[f"{part}_s"] for part in ("build", "reset", "first_step"))
    print(table(result))
    write_result("--json", args.json, json_module.dumps(result, indent=2) + "\n")
    return 0


def measure(configs: Configs, args: BenchArgs) -> dict[str, Any]:
    """Build a task from its configs and measure it."""
    from stripe_newton.envs.measure import benchmark  # here, so that its import is measured, and not done for --help
    from stripe_newton.sim.device import resolve_device  # likewise

    if args.num_envs is not None:
        configs.env.scene.num_envs = args.num_envs
    configs.env.seed = args.seed
    log = CompileLog.install()  # before the device is chosen, which initialises Warp
    set_device(configs.env, args.device)
    check(configs)
    set_seeds(args.seed)
    count, device = configs.env.scene.num_envs, configs.env.sim.device
    print(f"{args.task}: {count} environments on {device}", file=sys.stderr, flush=True)

    def build() -> TorchVectorEnv:
        # Else this process would compile the same modules beside the warm-up that the command has started.
        warm_up(device or resolve_device(None))
        env = make_env(args.task, configs.env)
        log.finish()
        return env

    return {"task": args.task, **benchmark(build, args.steps, args.seed)}


def table(result: dict[str, Any]) -> str:
    """The result of :func:`measure` as a table of text."""
    low, high = result["env_range_ms"]
    physics_low, physics_high = result["physics_range_ms"]
    calls = [
        (result[f"{kind}_per_step"], kind.replace("_", " "))
        for kind in ("graph_launches", "kernel_launches", "host_syncs")
    ]
    first = result["first_step_s"]
    on = result["device_name"] or result["device"]
    rows = [
        ("task", f"{result['task']}, {result['num_envs']} environments on {on}"),
        ("physics", f"{result['physics_ms']:.3f} ms ({physics_low:.3f} to {physics_high:.3f})"),
        ("whole step", f"{result['env_ms']:.3f} ms ({low:.3f} to {high:.3f})"),
        ("overhead", f"{100.0 * result['overhead_ratio']:.1f} % of the physics"),
        ("rate", f"{result['env_steps_per_s']:,.0f} environment steps a second"),
        ("a step", ", ".join(f"{n:.4g} {what}" for n, what in calls if n is not None) or "CUDA calls: none on the CPU"),
        ("start", f"{result['ready_s']:.2f} s from the command to the end of the first step, of them"),
        ("", f"{result['import_s']:.2f} s to import, {result['build_s']:.2f} s to build, {first:.2f} s for that step"),
    ]
    return "\n".join(f"{name:<12}{text}" for name, text in rows)
