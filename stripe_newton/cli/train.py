# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton train``: trains a policy, new or resumed, in one process or as one of several ranks."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

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
from stripe_newton.rl.experiments.sweep_process import end_with_sweep
from stripe_newton.rl.report.run_facts import write_changes
from stripe_newton.rl.report.run_report import REPORT_NAME, RunReport
from stripe_newton.rl.runs.film_overlay import FilmOverlay
from stripe_newton.rl.runs.live_training import TrainingView
from stripe_newton.rl.runs.run_folder import find_run
from stripe_newton.rl.runs.training_state import set_learning_rate
from stripe_newton.rl.runs.video import CPU_FPS, CPU_SECONDS, MAX_FPS, VIDEO_SECONDS, video_steps
from stripe_newton.rl.torch_vector_env import is_simulated, rl_env_of

from . import USER_ERRORS
from .arguments import parse, peek, task_of
from .determinism import make_deterministic, promise
from .device import set_device, set_seeds
from .env_and_policy import build
from .live_view import check_installed, open_viewer
from .options import TrainArgs
from .progress import steps_left
from .run_configs import Configs, check, load_configs
from .shell_command import command
from .train_ranks import launch_ranks, number_of_ranks, run_folder_of_all, split_over_ranks
from .train_resume import Changes, check_changes, differences
from .train_sweep import SweepOptions, run_sweep
from .train_teacher import check_teacher, use_teacher
from .user_error import UserError, check_count
from .written_places import try_place

__all__ = ["TrainArgs", "run"]


def run(argv: list[str]) -> int:
    """Run the command."""
    # First, so that no time is left in which the sweep could die unnoticed.
    end_with_sweep()
    task = task_of(argv, "train", TrainArgs)
    ranks = 1 if {"-h", "--help"} & set(argv) else number_of_ranks(peek(argv, "--gpus"))
    if ranks > 1 and peek(argv, "--sweep") is None:
        return launch_ranks(task, argv, ranks, USER_ERRORS)
    return as_rank(lambda: _train(task, argv), USER_ERRORS)


def _train(task: str, argv: Sequence[str]) -> int:
    """Train in this process, which may be one of several ranks."""
    resume = peek(argv, "--resume")
    resumed, checkpoint = find_run(resume) if resume else (None, None)
    configs = load_configs(task, resumed, same_device=True)
    teacher = peek(argv, "--teacher")
    if teacher and resumed is not None:
        raise UserError(f"--teacher {teacher}: a run that is resumed has its teacher in its checkpoint")
    if teacher:
        use_teacher(task, teacher, configs)
    # The configs of the resumed run, before the options of this command change them.
    before = {name: cfg.to_dict() for name, cfg in vars(configs).items()}
    args = parse(TrainArgs, argv, "train", env=configs.env, agent=configs.need_agent())
    if resumed is None:
        try_place("--log-dir", args.log_dir, folder=True)
    _apply_shortcuts(args, configs)
    check(configs)
    check_teacher(task, configs, resumed is not None)
    if args.sweep is not None:
        options = SweepOptions(args.sweep, args.jobs, args.device, args.log_dir, args.max_iterations, args.num_envs)
        return run_sweep(task, argv, options, configs)
    if args.jobs is not None:
        raise UserError(f"--jobs {args.jobs}: is for sweeps; give --sweep FILE too")
    changes = differences(before, {name: cfg.to_dict() for name, cfg in vars(configs).items()}) if resumed else {}
    keeps_episodes = check_changes(resume, changes, args.allow_changes)
    if resumed is not None and peek(argv, "--log-dir") and args.log_dir.resolve() not in resumed.path.resolve().parents:
        print(
            f"warning: --log-dir {args.log_dir} has no effect: {resumed.path} is resumed where it is", file=sys.stderr
        )
    if resumed is not None and checkpoint is None:
        print(f"{resume} contains no checkpoint yet: it starts anew")
    total_envs, from_default = configs.env.scene.num_envs, _changes_from_default(task, configs)
    split_over_ranks(configs)
    if args.deterministic:
        make_deterministic(configs.env.sim.device)
    # Each rank draws other noise on its actions.
    set_seeds(configs.need_agent().seed + world().rank)
    folder = _run_folder(task, args, configs, resumed)
    # From here on, so that a second training is refused before it builds anything.
    with folder.hold() if world().rank == 0 else contextlib.nullcontext():
        try:
            if resumed is None and world().rank == 0:
                # Before the environment is built, so that the run can be resumed from the beginning on.
                folder.write_task(task)
                folder.write_params(configs.env, configs.need_agent(), total_envs)
            runner = _build_runner(task, configs, folder, checkpoint, keeps_episodes, changes, args.allow_changes)
            # Once nothing is refused any more: a run that is not resumed stays as it is.
            if world().rank == 0:
                with contextlib.suppress(OSError):  # the report then leaves them out
                    write_changes(folder, from_default)
            if args.deterministic:
                print(promise(runner.env))
        except BaseException:
            # A task that cannot be built leaves no empty runs behind.
            if resumed is None and world().rank == 0:
                folder.remove_unused()
            raise
        return _run_to_end(task, args, runner, folder)


def _apply_shortcuts(args: TrainArgs, configs: Configs) -> None:
    """Write the command's own options into the configs."""
    env, agent = configs.env, configs.need_agent()
    if args.num_envs is not None:
        env.scene.num_envs = args.num_envs
    if args.max_iterations is not None:
        agent.max_iterations = args.max_iterations
    if args.runner is not None:
        agent.runner = args.runner
    if args.seed is not None:
        agent.seed = env.seed = args.seed
    elif env.seed is None:
        env.seed = agent.seed
    check_count("--video-interval", args.video_interval, least=0)
    if args.viewer == "viser":
        check_installed()
    set_device(env, args.device)


def _changes_from_default(task: str, configs: Configs) -> Changes:
    """Fields that differ from the task's own configs: by the command line, or in the run that is resumed."""
    default = {name: cfg.to_dict() for name, cfg in vars(load_configs(task, None)).items()}
    return differences(default, {name: cfg.to_dict() for name, cfg in vars(configs).items()})


def _run_folder(task: str, args: TrainArgs, configs: Configs, resumed: RunFolder | None) -> RunFolder:
    """The folder of this run, the same in all ranks: that of the resumed run, or a new one that rank 0 makes."""
    agent, folder = configs.need_agent(), resumed
    if folder is None and world().rank == 0:
        folder = RunFolder.create(args.log_dir, agent.experiment_name or task, agent.run_name)
    return RunFolder(run_folder_of_all(None if folder is None else folder.path))


def _build_runner(
    task: str,
    configs: Configs,
    folder: RunFolder,
    checkpoint: Path | None,
    keeps_episodes: bool,
    changes: Changes,
    networks_alone: bool,
) -> OnPolicyRunner:
    """Build environment and runner, and load the checkpoint of a resumed run."""
    agent = configs.need_agent()
    runner = build(task, configs, folder.path, render=world().rank == 0)
    runner.task = task
    inner = rl_env_of(runner.env.unwrapped)
    if inner is not None and world().rank == 0:
        print(f"physics: {inner.sim.describe_solver()}")
    if agent.runner == "graph" and world().rank == 0 and runner.device != "cpu":
        for part, reason in runner.no_graphs.items():
            print(f"the {part} runs rsl_rl's own code rather than a graph: {reason}")
    if checkpoint is not None:
        runner.resume(checkpoint, keeps_episodes, networks_alone)
        done = runner.iterations_done
        if done >= agent.max_iterations:
            raise UserError(
                f"{checkpoint}: {done} iterations are done, of {agent.max_iterations}; "
                "give --max-iterations to go further"
            )
        print(f"continuing after iteration {done} of {checkpoint}")
    if "agent.algorithm.learning_rate" in changes:
        # The checkpoint has the rate that the adaptive schedule had come to; one that was given overrides it.
        set_learning_rate(runner.alg, agent.algorithm.learning_rate)
    return runner


def _run_to_end(task: str, args: TrainArgs, runner: OnPolicyRunner, folder: RunFolder) -> int:
    """Learn, leave curve, policy and video in the run folder, and print what can be done next."""
    print(f"run folder: {folder.path}", flush=True)
    try:
        complete = _learn(runner, folder, task, args)
        if world().rank == 0:
            _finish(runner, folder, task, complete, film=args.final_video)
    except BaseException:
        print(f"\nended early; files so far are in {folder.path}", file=sys.stderr)
        raise
    finally:
        runner.env.close()
    _print_next(task, folder, complete)
    return 0


def _learn(runner: OnPolicyRunner, folder: RunFolder, task: str, args: TrainArgs) -> bool:
    if world().rank:  # rank 0 alone can draw pictures
        return runner.learn()
    with contextlib.ExitStack() as stack:
        if args.video_interval:
            film = TrainingVideo(runner.env, folder.videos, args.video_interval, video_steps(runner.env), task)
            stack.callback(film.close)
            runner.logger.iteration_hooks.append(film.after_iteration)
        if args.viewer == "viser":
            _show(runner, task, args, stack)
        return runner.learn()


def _show(runner: OnPolicyRunner, task: str, args: TrainArgs, stack: contextlib.ExitStack) -> None:
    """Open the live view of a training, which the stack closes."""
    inner = runner.env.unwrapped
    if not is_simulated(inner):
        raise UserError(f"--viewer viser: {type(inner).__name__} has no simulation to show")
    viewer = stack.enter_context(open_viewer(inner, task, args.host, args.port, reset=False, is_paced=False, fps=20.0))
    view = TrainingView(runner, viewer)
    stack.callback(view.close)
    runner.logger.iteration_hooks.append(view.after_iteration)


def _finish(runner: OnPolicyRunner, folder: RunFolder, task: str, complete: bool, film: bool = True) -> None:
    """Write the learning curve, the exported policy, after a complete run the video, and the report."""
    try:
        plot_learning_curve(folder.metrics, folder.learning_curve, f"{task}, {runner.iterations_done} iterations")
    except (ValueError, OSError) as error:
        print(f"no learning curve: {error}", file=sys.stderr)
    failed: ExportError | None = None
    print("exporting the policy", flush=True)
    try:
        print(export_policy(runner, folder.exported))
    except ExportError as error:
        failed = error  # raised after the video, which does not depend on the export
    if complete and film:
        _film(runner, task, folder.videos / f"final_{runner.iterations_done}.mp4")
        RunReport(folder).finish()  # again, with the film
    if failed is not None:
        raise failed


def _film(runner: OnPolicyRunner, task: str, path: Path) -> None:
    """Film the trained policy; on the CPU with fewer frames, so that it does not take longer than a short training."""
    seconds, fps = (CPU_SECONDS, CPU_FPS) if runner.device == "cpu" else (VIDEO_SECONDS, MAX_FPS)
    steps = video_steps(runner.env, seconds)
    print(f"filming {steps} steps (--final-video False: no video)", flush=True)
    overlay = FilmOverlay(runner.env, task, f"after {runner.iterations_done} iterations")
    policy = runner.get_inference_policy(runner.device)
    progress = steps_left("filmed", steps)
    record_video(runner.env, policy, path, steps, most_fps=fps, overlay=overlay, progress=progress)


def _print_next(task: str, folder: RunFolder, complete: bool) -> None:
    """Print the commands that continue, play and evaluate the run."""
    path = str(folder.path)
    if not complete:
        ranks = ["--gpus", str(world().size)] if world().size > 1 else []
        print(f"stopped; continue with:\n  {command('train', task, *ranks, '--resume', path)}")
    print(f"run folder: {folder.path}")
    for file in (folder.path / REPORT_NAME, folder.learning_curve, *sorted(folder.videos.glob("*.mp4"))[-1:]):
        if file.exists():
            print(f"  {file.relative_to(folder.path)}")
    print("next:")
    for verb in ("play", "eval"):
        print(f"  {command(verb, task, '--checkpoint', path)}")
    print(f"  tensorboard --logdir {shlex.quote(str(folder.path.parent))}")
