# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton play``: shows a policy live, as a video, or as numbers."""

from __future__ import annotations

import importlib.util
import time
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from stripe_newton.rl import (
    Policy,
    RandomPolicy,
    RslRlVecEnvWrapper,
    ZeroPolicy,
    record_video,
)
from stripe_newton.rl.runs.video import video_steps
from stripe_newton.rl.torch_vector_env import is_simulated

from .arguments import parse, peek, task_of
from .device import set_device, set_seeds
from .env_and_policy import build_env, build_policy, find_policy
from .options import PlayArgs
from .run_configs import Configs, check, load_configs, use_one_minibatch
from .user_error import UserError
from .written_places import try_place

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnvCfg

__all__ = ["PlayArgs", "run"]


def run(argv: list[str]) -> int:
    """Run the command."""
    task = task_of(argv, "play", PlayArgs)
    checkpoint, folder = find_policy(peek(argv, "--checkpoint"), task)
    configs = load_configs(task, folder, agent=checkpoint is not None and checkpoint.suffix != ".onnx")
    args = parse(PlayArgs, argv, "play", env=configs.env)
    _prepare(args, configs)
    name = f"play_{checkpoint.stem}.mp4" if checkpoint else f"{task}_{args.agent}.mp4"
    path = (folder.videos if folder else Path("videos")) / name
    try_place("video", path if args.viewer == "video" else None)
    env, policy = _env_and_policy(task, args, configs, checkpoint)
    try:
        if args.viewer == "video":
            print(record_video(env, policy, path, args.steps or video_steps(env), args.seed))
        elif args.viewer == "viser":
            _watch(env, policy, configs.env, args)
        else:
            _roll(env, policy, args.steps or int(env.max_episode_length), args.seed)
    finally:
        env.close()
    return 0


def _prepare(args: PlayArgs, configs: Configs) -> None:
    args.check()
    if args.viewer is None:
        args.viewer = "viser" if importlib.util.find_spec("viser") else "video"
    default = min(configs.env.scene.num_envs, 16)
    configs.env.scene.num_envs = default if args.num_envs is None else args.num_envs
    configs.env.seed = args.seed if args.seed is not None else configs.env.seed
    set_device(configs.env, args.device)
    if configs.agent is not None:
        use_one_minibatch(configs.agent)
    check(configs)
    set_seeds(configs.env.seed or 0)


def _env_and_policy(
    task: str, args: PlayArgs, configs: Configs, checkpoint: Path | None
) -> tuple[RslRlVecEnvWrapper, Policy]:
    if checkpoint is not None:
        return build_policy(task, configs, checkpoint, render=args.viewer == "video")
    env = build_env(task, configs, render=args.viewer == "video")
    return env, ZeroPolicy(env) if args.agent == "zero" else RandomPolicy(env)


@torch.inference_mode()
def _watch(env: RslRlVecEnvWrapper, policy: Policy, cfg: RLEnvCfg, args: PlayArgs) -> None:
    """Show the environments live, in real time, until Ctrl-C or for so many steps."""
    from stripe_newton.viewers import LiveViewer  # here, as it needs viser, which need not be installed

    inner = env.unwrapped
    if not is_simulated(inner):
        raise UserError(f"--viewer viser: {type(inner).__name__} has no simulation to show; use --viewer video")
    try:
        viewer = LiveViewer(inner.sim, list(range(env.num_envs)))
    except ImportError as error:
        raise UserError(str(error)) from None
    print(f"{viewer.url}  (Ctrl-C to stop)", flush=True)
    obs = env.reset(args.seed)
    policy.reset()
    step_dt = env.unwrapped.step_dt
    # The viewer's interval is in steps of the physics, this loop's in steps of the environment.
    interval = max(1, round(cfg.sim.render_interval / cfg.decimation))
    try:
        step = 0
        due = time.monotonic()
        while viewer.is_running() and (args.steps is None or step < args.steps):
            obs, _, dones, _ = env.step(policy(obs))
            policy.reset(dones)
            step += 1
            if step % interval == 0:
                viewer.update(interval * step_dt)
            # Real time, but a delay of more than a second is not caught up with.
            due = max(due + step_dt, time.monotonic() - 1.0)
            time.sleep(max(0.0, due - time.monotonic()))
    except KeyboardInterrupt:
        print()
    finally:
        viewer.close()


@torch.inference_mode()
def _roll(env: RslRlVecEnvWrapper, policy: Policy, steps: int, seed: int | None) -> None:
    """Act without pictures and print rewards and ends of episodes."""
    obs = env.reset(seed)
    policy.reset()
    total, ended = 0.0, 0
    for _ in range(steps):
        obs, rewards, dones, _ = env.step(policy(obs))
        policy.reset(dones)
        total += float(rewards.mean())
        ended += int(dones.sum())
    print(f"{steps} steps of {env.num_envs} environments: {total / steps:.4g} reward a step, {ended} episodes ended")
