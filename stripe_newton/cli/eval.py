# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton eval``: measures a trained policy over a number of episodes."""

from __future__ import annotations

import json as json_module

from stripe_newton.rl import evaluate, find_checkpoint

from .arguments import parse, peek, task_of
from .determinism import make_deterministic, promise
from .device import set_device, set_seeds
from .env_and_policy import build_policy, find_policy
from .options import EvalArgs
from .run_configs import check, load_configs, use_one_minibatch
from .user_error import check_count
from .written_places import try_place, write_result

__all__ = ["EvalArgs", "run"]


def run(argv: list[str]) -> int:
    """Run the command."""
    task = task_of(argv, "eval", EvalArgs)
    checkpoint, folder = find_policy(peek(argv, "--checkpoint"), task)
    exported = checkpoint is not None and checkpoint.suffix == ".onnx"
    configs = load_configs(task, folder, agent=not exported)
    args = parse(EvalArgs, argv, "eval", env=configs.env)
    check_count("--episodes", args.episodes)
    try_place("--json", args.json)
    # More environments than episodes would only wait.
    default = min(configs.env.scene.num_envs, args.episodes)
    configs.env.scene.num_envs = default if args.num_envs is None else args.num_envs
    configs.env.seed = args.seed if args.seed is not None else configs.env.seed
    set_device(configs.env, args.device)
    if configs.agent is not None:
        use_one_minibatch(configs.agent)
    check(configs)
    if args.deterministic:
        make_deterministic(configs.env.sim.device)
    set_seeds(configs.env.seed or 0)

    env, policy = build_policy(task, configs, checkpoint or find_checkpoint(args.checkpoint))
    try:
        if args.deterministic:
            print(promise(env))
        result = evaluate(env, policy, args.episodes, task=task, seed=configs.env.seed)
    finally:
        env.close()
    found = result.to_dict()
    shown = {k: v for k, v in found.items() if k != "metrics"} | result.metrics
    width = max(map(len, shown)) + 2
    for name, value in shown.items():
        print(f"{name:<{width}}{value:.4g}" if isinstance(value, float) else f"{name:<{width}}{value}")
    write_result("--json", args.json, json_module.dumps(found, indent=2) + "\n")
    return 0
