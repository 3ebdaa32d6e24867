# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train``."""

from __future__ import annotations

import contextlib
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from stripe_newton.rl import (
    OnPolicyRunner,
    RunFolder,
    TrainingVideo,
    export_policy,
    find_checkpoint,
    plot_learning_curve,
    record_video,
)

from .common import (
    Configs,
    build,
    check,
    load_configs,
    parse,
    peek,
    program,
    set_device,
    set_seeds,
    task_of,
    video_steps,
)
from .errors import UserError

__all__ = ["TrainArgs", "run"]


@dataclass
class TrainArgs:
    """Train a policy for a task; TASK --help also shows every field of its configuration."""

    task: tyro.conf.Positional[str]
    """The task, one of 'stripe-newton list'."""
    num_envs: tyro.conf.DisallowNone[int | None] = None
    """Number of environments; short for --env.scene.num-envs."""
    max_iterations: tyro.conf.DisallowNone[int | None] = None
    """Iterations of the whole run; short for --agent.max-iterations."""
    seed: tyro.conf.DisallowNone[int | None] = None
    """Seed of everything; short for --agent.seed and --env.seed."""
    device: tyro.conf.DisallowNone[str | None] = None
    """cpu or cuda:N; by default the first GPU where there is one. Short for --env.sim.device."""
    log_dir: Path = Path("logs")
    """Where run folders are made: LOG_DIR/EXPERIMENT/DATE_TIME."""
    video_interval: int = 0
    """Film the training every so many iterations; 0 for one video at the end."""
    resume: tyro.conf.DisallowNone[str | None] = None
    """A run folder, or a checkpoint of one, to go on with; its configuration is taken over."""


def run(argv: list[str]) -> int:
    """Run the command."""
    task = task_of(argv, "train", TrainArgs)
    resume = peek(argv, "--resume")
    checkpoint = find_checkpoint(resume) if resume else None
    folder = RunFolder.of_checkpoint(checkpoint) if checkpoint else None
    configs = load_configs(task, folder, same_device=True)
    args = parse(TrainArgs, argv, "train", env=configs.env, agent=configs.agent)
    _apply_shortcuts(args, configs)
    check(configs)
    set_seeds(configs.agent.seed)
    if folder is None:
        folder = RunFolder.create(args.log_dir, configs.agent.experiment_name or task, configs.agent.run_name)
    try:
        runner = _start(task, configs, folder, checkpoint)
    except BaseException:
        with contextlib.suppress(OSError):
            folder.path.rmdir()  # a new folder, still empty
        raise
    folder.write_task(task)
    print(f"run folder: {folder.path}", flush=True)
    try:
        complete = _learn(runner, folder, args.video_interval)
        _finish(runner, folder, task, complete)
    except BaseException:
        print(f"\nended early; what there is lies in {folder.path}", file=sys.stderr)
        raise
    finally:
        runner.env.close()
    _print_next(task, folder, complete)
    return 0


def _start(task: str, configs: Configs, folder: RunFolder, checkpoint: Path | None) -> OnPolicyRunner:
    runner = build(task, configs, folder.path, render=True)
    if checkpoint is not None:
        runner.resume(checkpoint)
        if runner.iterations_done >= configs.agent.max_iterations:
            done, total = runner.iterations_done, configs.agent.max_iterations
            raise UserError(
                f"{checkpoint}: {done} iterations are done, of {total}; give --max-iterations to go further"
            )
        print(f"going on after iteration {runner.iterations_done} of {checkpoint}")
    return runner


def _apply_shortcuts(args: TrainArgs, configs: Configs) -> None:
    if args.num_envs is not None:
        configs.env.scene.num_envs = args.num_envs
    if args.max_iterations is not None:
        configs.agent.max_iterations = args.max_iterations
    if args.seed is not None:
        configs.agent.seed = configs.env.seed = args.seed
    elif configs.env.seed is None:
        configs.env.seed = configs.agent.seed
    if args.video_interval < 0:
        raise UserError(f"--video-interval {args.video_interval}: must be 0 or more iterations")
    set_device(configs.env, args.device)


def _learn(runner: OnPolicyRunner, folder: RunFolder, video_interval: int) -> bool:
    if not video_interval:
        return runner.learn()
    film = TrainingVideo(runner.env, folder.videos, video_interval, video_steps(runner.env))
    runner.logger.iteration_hooks.append(film.after_iteration)
    try:
        return runner.learn()
    finally:
        film.close()


def _finish(runner: OnPolicyRunner, folder: RunFolder, task: str, complete: bool) -> None:
    """Leave the learning curve, the exported policy and, after a complete run, the video."""
    try:
        plot_learning_curve(folder.metrics, folder.learning_curve, f"{task}, {runner.iterations_done} iterations")
    except ValueError as error:
        print(f"no learning curve: {error}", file=sys.stderr)
    export_policy(runner, folder.exported)
    if complete:
        policy = runner.get_inference_policy(runner.device)
        name = f"final_{runner.iterations_done}.mp4"
        record_video(runner.env, policy, folder.videos / name, video_steps(runner.env))


def _print_next(task: str, folder: RunFolder, complete: bool) -> None:
    path, command = shlex.quote(str(folder.path)), program()
    if not complete:
        print(f"stopped; go on with:\n  {command} train {task} --resume {path}")
    print(
        f"run folder: {folder.path}\n"
        "next:\n"
        f"  {command} play {task} --checkpoint {path}\n"
        f"  {command} eval {task} --checkpoint {path}"
    )
