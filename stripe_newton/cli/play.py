# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton play``: shows a policy live, as a video, or as numbers."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
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
from stripe_newton.rl.runs.film_overlay import FilmOverlay
from stripe_newton.rl.runs.run_checkpoints import RunCheckpoints
from stripe_newton.rl.runs.video import video_steps
from stripe_newton.rl.torch_vector_env import is_simulated

from .arguments import parse, peek, task_of
from .device import set_device, set_seeds
from .env_and_policy import build, build_env, build_policy, find_policy
from .live_view import FPS, check_installed, open_viewer
from .options import PlayArgs
from .progress import steps_left
from .run_configs import Configs, check, load_configs, use_one_minibatch
from .user_error import UserError
from .written_places import try_place

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnvCfg
    from stripe_newton.viewers import LiveViewer

    from .options import DemoArgs

__all__ = ["PlayArgs", "roll", "run", "watch"]


def run(argv: list[str]) -> int:
    """Run the command."""
    task = task_of(argv, "play", PlayArgs)
    checkpoint, folder = find_policy(peek(argv, "--checkpoint"), task)
    configs = load_configs(task, folder, agent=checkpoint is not None and checkpoint.suffix != ".onnx")
    args = parse(PlayArgs, argv, "play", env=configs.env)
    _prepare(args, configs)
    name = f"play_{checkpoint.stem}.mp4" if checkpoint else f"{task}_{args.agent}.mp4"
    path = (folder.videos if folder else Path("videos")) / name
    if args.viewer == "video" and folder is not None:
        folder.check_links(folder.videos)
    try_place("video", path if args.viewer == "video" else None)
    env, policy, checkpoints = _env_and_policy(task, args, configs, checkpoint)
    try:
        if args.viewer == "video":
            note = checkpoint.stem.replace("model_", "iteration ") if checkpoint else f"{args.agent} actions"
            overlay = FilmOverlay(env, task, note)
            steps = args.steps or video_steps(env)
            progress = steps_left("filmed", steps)
            print(record_video(env, policy, path, steps, args.seed, overlay=overlay, progress=progress))
        elif args.viewer == "viser":
            watch(task, env, policy, configs.env, args, checkpoints=checkpoints)
        else:
            roll(env, policy, args.steps or int(env.max_episode_length), args.seed)
    finally:
        env.close()
    return 0


def _prepare(args: PlayArgs, configs: Configs) -> None:
    args.check()
    if args.viewer is None:
        args.viewer = "viser" if importlib.util.find_spec("viser") else "video"
    if args.viewer == "viser":
        check_installed()
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
) -> tuple[RslRlVecEnvWrapper, Policy, RunCheckpoints | None]:
    """The environment, what acts in it and, for the live view of a run, its checkpoints."""
    render = args.viewer == "video"
    if checkpoint is None:
        env = build_env(task, configs, render)
        return env, ZeroPolicy(env) if args.agent == "zero" else RandomPolicy(env), None
    if checkpoint.suffix == ".onnx" or args.viewer != "viser":
        return *build_policy(task, configs, checkpoint, render), None
    runner = build(task, configs, checkpoint=checkpoint)
    policy = runner.get_inference_policy(runner.device)
    return runner.env, policy, RunCheckpoints(runner, checkpoint, policy.reset)


@torch.inference_mode()
def watch(
    task: str,
    env: RslRlVecEnvWrapper,
    policy: Policy,
    cfg: RLEnvCfg,
    args: PlayArgs | DemoArgs,
    on_open: Callable[[LiveViewer], None] | None = None,
    checkpoints: RunCheckpoints | None = None,
) -> None:
    """Show the environments live, at the speed that the page says, until Ctrl-C or for so many steps.

    Args:
        task: Name of what is shown.
        env: The wrapped environment.
        policy: What acts.
        cfg: Config of the environment.
        args: Address, seed and number of steps.
        on_open: Called once, when the page can be opened and the first step was taken.
        checkpoints: Policies to switch between.

    Raises:
        UserError: if the environment has no simulation to show, or the page cannot be served.
    """
    inner = env.unwrapped
    if not is_simulated(inner):
        raise UserError(f"--viewer viser: {type(inner).__name__} has no simulation to show; use --viewer video")

    def reset() -> None:
        env.reset()
        policy.reset()

    # The interval of the pictures is in steps of the physics.
    fps = min(FPS, 1.0 / (cfg.sim.dt * cfg.sim.render_interval))
    viewer = open_viewer(inner, task, args.host, args.port, reset=reset, fps=fps, checkpoints=checkpoints)
    env.reset(args.seed)
    policy.reset()
    try:
        for _ in viewer.steps(args.steps):
            # Asked for anew in each step, as a click may have begun new episodes.
            _, _, dones, _ = env.step(policy(env.get_observations()))
            policy.reset(dones)
            if on_open is not None:
                on_open(viewer)
                on_open = None
    except KeyboardInterrupt:
        print()
    finally:
        viewer.close()


@torch.inference_mode()
def roll(env: RslRlVecEnvWrapper, policy: Policy, steps: int, seed: int | None) -> None:
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
