# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from stripe_newton.rl import (
    ExportError,
    OnPolicyRunner,
    RunFolder,
    TrainingVideo,
    export_policy,
    plot_learning_curve,
    record_video,
)
from stripe_newton.rl.distributed import as_rank, world
from stripe_newton.rl.run_folder import find_run
from stripe_newton.rl.sweep_process import end_with_sweep
from stripe_newton.rl.training_state import set_learning_rate

from . import USER_ERRORS
from .common import (
    Configs,
    build,
    check,
    command,
    load_configs,
    parse,
    peek,
    set_device,
    set_seeds,
    task_of,
    video_steps,
)
from .errors import UserError
from .ranks import launch_ranks, number_of_ranks, run_folder_of_all, split_over_ranks
from .resume import check_changes, differences

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
    final_video: bool = True
    """Whether the trained policy is filmed at the end."""
    runner: tyro.conf.DisallowNone[Literal["graph", "rsl_rl"] | None] = None
    """Rollout and update as CUDA graphs where they can be, or rsl_rl's own, untouched; short for --agent.runner."""
    resume: tyro.conf.DisallowNone[str | None] = None
    """A run folder, or a checkpoint of one, to go on with; its configuration is taken over."""
    allow_changes: bool = False
    """Let a resumed run go on with another environment or other networks than it had."""
    gpus: tyro.conf.DisallowNone[int | None] = None
    """Train on so many GPUs of this host, one process on each; --num-envs counts the environments of all."""
    sweep: tyro.conf.DisallowNone[Path | None] = None
    """A YAML file of fields and seeds to try; a run for each, in a process of its own."""
    jobs: tyro.conf.DisallowNone[int | None] = None
    """Runs of a sweep at a time: by default one on each GPU, or one on the CPU."""


def run(argv: list[str]) -> int:
    """Run the command."""
    end_with_sweep()
    task = task_of(argv, "train", TrainArgs)
    ranks = 1 if {"-h", "--help"} & set(argv) else number_of_ranks(peek(argv, "--gpus"))
    if ranks > 1 and peek(argv, "--sweep") is None:
        return launch_ranks(task, argv, ranks)
    return as_rank(lambda: _train(task, argv), USER_ERRORS)


def _train(task: str, argv: list[str]) -> int:
    resume = peek(argv, "--resume")
    folder, checkpoint = find_run(resume) if resume else (None, None)
    configs = load_configs(task, folder, same_device=True)
    before = {name: cfg.to_dict() for name, cfg in vars(configs).items()}
    args = parse(TrainArgs, argv, "train", env=configs.env, agent=configs.agent)
    _apply_shortcuts(args, configs)
    check(configs)
    if args.sweep is not None:
        from .sweep import run_sweep

        return run_sweep(task, argv, args, configs)
    if args.jobs is not None:
        raise UserError(f"--jobs {args.jobs}: are the runs of a sweep; give --sweep FILE, too")
    changes = differences(before, {name: cfg.to_dict() for name, cfg in vars(configs).items()}) if folder else {}
    episodes = check_changes(resume, changes, args.allow_changes)
    total = configs.env.scene.num_envs
    split_over_ranks(configs)
    set_seeds(configs.agent.seed + world().rank)
    is_new = folder is None
    if not is_new and checkpoint is None:
        print(f"{resume} holds no checkpoint yet: it begins anew")
    if is_new and world().rank == 0:
        folder = RunFolder.create(args.log_dir, configs.agent.experiment_name or task, configs.agent.run_name)
    folder = RunFolder(run_folder_of_all(None if folder is None else folder.path))
    try:
        if is_new and world().rank == 0:
            folder.write_task(task)
            folder.write_params(configs.env, configs.agent, total)  # so that it can be resumed from the beginning on
        runner = _start(task, configs, folder, checkpoint, episodes)
    except BaseException:
        if is_new and world().rank == 0:
            folder.remove_unused()
        raise
    if "agent.algorithm.learning_rate" in changes:
        set_learning_rate(runner.alg, configs.agent.algorithm.learning_rate)
    print(f"run folder: {folder.path}", flush=True)
    try:
        complete = _learn(runner, folder, args.video_interval)
        if world().rank == 0:
            _finish(runner, folder, task, complete, film=args.final_video)
    except BaseException:
        print(f"\nended early; what there is lies in {folder.path}", file=sys.stderr)
        raise
    finally:
        runner.env.close()
    _print_next(task, folder, complete)
    return 0


def _start(task: str, configs: Configs, folder: RunFolder, checkpoint: Path | None, episodes: bool) -> OnPolicyRunner:
    runner = build(task, configs, folder.path, render=world().rank == 0)
    if configs.agent.runner == "graph" and world().rank == 0 and runner.device != "cpu":
        for part, reason in runner.no_graphs.items():
            print(f"the {part} is rsl_rl's own and no graph: {reason}")
    if checkpoint is not None:
        runner.resume(checkpoint, episodes)
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
    if args.runner is not None:
        configs.agent.runner = args.runner
    if args.seed is not None:
        configs.agent.seed = configs.env.seed = args.seed
    elif configs.env.seed is None:
        configs.env.seed = configs.agent.seed
    if args.video_interval < 0:
        raise UserError(f"--video-interval {args.video_interval}: must be 0 or more iterations")
    set_device(configs.env, args.device)


def _learn(runner: OnPolicyRunner, folder: RunFolder, video_interval: int) -> bool:
    if not video_interval or world().rank:
        return runner.learn()
    film = TrainingVideo(runner.env, folder.videos, video_interval, video_steps(runner.env))
    runner.logger.iteration_hooks.append(film.after_iteration)
    try:
        return runner.learn()
    finally:
        film.close()


def _finish(runner: OnPolicyRunner, folder: RunFolder, task: str, complete: bool, film: bool = True) -> None:
    """Leave the learning curve, the exported policy and, after a complete run, the video."""
    try:
        plot_learning_curve(folder.metrics, folder.learning_curve, f"{task}, {runner.iterations_done} iterations")
    except ValueError as error:
        print(f"no learning curve: {error}", file=sys.stderr)
    unlike: ExportError | None = None
    try:
        print(export_policy(runner, folder.exported))
    except ExportError as error:
        unlike = error  # after the video
    if complete and film:
        policy = runner.get_inference_policy(runner.device)
        name = f"final_{runner.iterations_done}.mp4"
        record_video(runner.env, policy, folder.videos / name, video_steps(runner.env))
    if unlike is not None:
        raise unlike


def _print_next(task: str, folder: RunFolder, complete: bool) -> None:
    path = str(folder.path)
    if not complete:
        ranks = ["--gpus", str(world().size)] if world().size > 1 else []
        print(f"stopped; go on with:\n  {command('train', task, *ranks, '--resume', path)}")
    print(f"run folder: {folder.path}\nnext:")
    for verb in ("play", "eval"):
        print(f"  {command(verb, task, '--checkpoint', path)}")
