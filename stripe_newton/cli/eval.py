# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton eval``: measures a trained policy over a number of episodes."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from pathlib import Path

import tyro

from stripe_newton.rl import evaluate, find_checkpoint

from .arguments import parse, peek, task_of
from .device import set_device, set_seeds
from .env_and_policy import build_policy, find_policy
from .run_configs import check, load_configs, use_one_minibatch
from .user_error import UserError

__all__ = ["EvalArgs", "run"]


@dataclass
class EvalArgs:
    """Measure a trained policy: mean return and length of a number of whole episodes, without exploration."""

    task: tyro.conf.Positional[str]
    """The task, one of 'stripe-newton list'."""
    checkpoint: str
    """A run folder, of which the newest checkpoint is taken, a checkpoint file, or an exported policy (.onnx)."""
    num_envs: tyro.conf.DisallowNone[int | None] = None
    """Number of environments; by default those of the training, but no more than episodes."""
    episodes: int = 100
    """Number of episodes."""
    seed: tyro.conf.DisallowNone[int | None] = None
    """Seed of everything; by default the one of the training."""
    device: tyro.conf.DisallowNone[str | None] = None
    """cpu or cuda:N; by default the first GPU where there is one."""
    json: tyro.conf.DisallowNone[Path | None] = None
    """File to write the result to."""


def run(argv: list[str]) -> int:
    """Run the command."""
    task = task_of(argv, "eval", EvalArgs)
    checkpoint, folder = find_policy(peek(argv, "--checkpoint"), task)
    exported = checkpoint is not None and checkpoint.suffix == ".onnx"
    configs = load_configs(task, folder, agent=not exported)
    args = parse(EvalArgs, argv, "eval", env=configs.env)
    if args.episodes < 1:
        raise UserError(f"--episodes {args.episodes}: must be at least 1")
    # More environments than episodes would only wait.
    configs.env.scene.num_envs = args.num_envs or min(configs.env.scene.num_envs, args.episodes)
    configs.env.seed = args.seed if args.seed is not None else configs.env.seed
    set_device(configs.env, args.device)
    if configs.agent is not None:
        use_one_minibatch(configs.agent)
    check(configs)
    set_seeds(configs.env.seed or 0)

    env, policy = build_policy(task, configs, checkpoint or find_checkpoint(args.checkpoint))
    try:
        result = evaluate(env, policy, args.episodes, task=task, seed=configs.env.seed)
    finally:
        env.close()
    found = result.to_dict()
    shown = {k: v for k, v in found.items() if k != "metrics"} | result.metrics
    width = max(map(len, shown)) + 2
    for name, value in shown.items():
        print(f"{name:<{width}}{value:.4g}" if isinstance(value, float) else f"{name:<{width}}{value}")
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json_module.dumps(found, indent=2) + "\n", encoding="utf-8")
    return 0
