# SPDX-License-Identifier: Apache-2.0
"""What train, eval and play have in common: options, devices, seeds and the configs of a run."""

from __future__ import annotations

import dataclasses
import os
import random
import shlex
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch
import tyro
import warp as wp

from stripe_newton.configclass import ConfigError, validate
from stripe_newton.rl import RunFolder, find_checkpoint
from stripe_newton.rl.distributed import rank_device, world

from .errors import UserError
from .fields import apply_options, apply_saved, options_of
from .tasks import find_task, import_options, load_cfg, make_env, task_argument

if TYPE_CHECKING:  # rsl_rl takes a second to import, and bench has no use for it
    from stripe_newton.rl import OnPolicyRunner, Policy, RslRlVecEnvWrapper

__all__ = [
    "Configs",
    "build",
    "build_env",
    "build_policy",
    "check",
    "find_policy",
    "learn_nothing",
    "load_configs",
    "parse",
    "peek",
    "program",
    "set_device",
    "set_seeds",
    "task_of",
    "video_steps",
]

T = TypeVar("T")
VIDEO_SECONDS = 10.0
"""Longest video that is made without being asked for its length."""


@dataclass
class Configs:
    """The configs of an environment and, for a task that has one, of its agent."""

    env: Any
    agent: Any


def peek(argv: list[str], option: str) -> str | None:
    """The value of an option that the others depend on, before they are parsed."""
    for word, following in zip(argv, [*argv[1:], None], strict=True):
        name, equals, value = word.partition("=")
        if name == option:
            return value if equals else following
    return None


def task_of(argv: list[str], command: str, options: type) -> str:
    """The task that a command's arguments name.

    Raises:
        UserError: if they name none, or an unknown one.
        SystemExit: after help, if that is asked for without a task.
    """
    task = task_argument(argv)
    if task is None and {"-h", "--help"} & set(argv):
        tyro.cli(options, args=["--help"], prog=f"stripe-newton {command}")
    if task is None:
        raise UserError(f"{command} needs a task: stripe-newton {command} TASK; 'stripe-newton list' shows all")
    find_task(task)
    return task


def load_configs(task: str, run: RunFolder | None, *, agent: bool = True, same_device: bool = False) -> Configs:
    """The configs of a task, with the values of an earlier run if one is given; its device only if that is wanted.

    A run of ``NAME-v0`` fits ``NAME-Play-v0`` too, of which the environment keeps its own values.

    Raises:
        UserError: if that run is of another task.
    """
    of_run = task if run is None else run.read_task() or task
    if of_run not in (task, task.replace("-Play-", "-")):
        raise UserError(f"{run.path if run else ''} is a run of {of_run}, not of {task}")
    configs = Configs(load_cfg(task, "env"), load_cfg(task, "agent") if agent else None)
    if run is not None:
        saved = run.read_params()
        if not same_device:
            saved["env"].get("sim", {}).pop("device", None)
        leftovers = apply_saved(configs.env, saved["env"], "env") if of_run == task else []
        leftovers += apply_saved(configs.agent, saved["agent"], "agent") if agent else []
        if leftovers:
            lines = "\n".join(f"  {line}" for line in leftovers)
            print(f"warning: the task is not what it was when {run.path} was made:\n{lines}", file=sys.stderr)
    return configs


def parse(options: type[T], argv: list[str], command: str, **configs: Any) -> T:
    """Parse a command's own options and those for the fields of ``configs``, and write the latter into the configs."""
    nested = {name: type(options_of(cfg, name)) for name, cfg in configs.items()}
    fields = [(name, kind, dataclasses.field(default_factory=kind)) for name, kind in nested.items()]
    full = dataclasses.make_dataclass("Args", fields, bases=(options,), namespace={"__doc__": options.__doc__})
    args: Any = tyro.cli(full, args=argv, prog=f"stripe-newton {command}", config=(tyro.conf.FlagConversionOff,))
    for name, cfg in configs.items():
        apply_options(cfg, getattr(args, name))
    return args


def set_device(env_cfg: Any, requested: str | None) -> None:
    """Write the device to run on into ``env_cfg``: the requested one, the configured one, the first GPU, or the CPU;
    where several processes train together, the one of this rank.

    Raises:
        UserError: if the requested one is not there.
    """
    if world().size > 1:
        try:
            env_cfg.sim.device = rank_device(requested, env_cfg.sim.device)
        except ValueError as error:
            raise UserError(str(error)) from None
        return
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    devices = ["cpu", *(f"cuda:{index}" for index in range(count))]
    requested = "cuda:0" if requested == "cuda" else requested
    if requested is not None and requested not in devices:
        raise UserError(f"--device {requested}: there is no such device, this machine has {', '.join(devices)}")
    configured = "cuda:0" if env_cfg.sim.device == "cuda" else env_cfg.sim.device
    if requested is None and configured is not None and configured not in devices:
        print(f"the configured device {configured} is not there, using {devices[count and 1]}", file=sys.stderr)
        configured = None
    env_cfg.sim.device = requested or configured or ("cuda:0" if count else "cpu")


def set_seeds(seed: int) -> None:
    """Seed Python, NumPy and torch."""
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002 (user code may draw from the global generator)
    torch.manual_seed(seed)


def check(configs: Configs) -> None:
    """Validate both configs.

    Raises:
        ConfigError: all problems of both, with paths as on the command line.
    """
    problems: list[str] = []
    for name in ("env", "agent"):
        try:
            if getattr(configs, name) is not None:
                validate(getattr(configs, name))
        except ConfigError as error:
            problems += [f"{name}.{problem}" for problem in error.problems]
    if problems:
        raise ConfigError(problems)


def build(
    task: str, configs: Configs, log_dir: Path | None = None, render: bool = False, checkpoint: Path | None = None
) -> OnPolicyRunner:
    """The environment and the runner of a task, with the policy of ``checkpoint`` if one is given."""
    from stripe_newton.rl import DistillationRunner, OnPolicyRunner, RslRlDistillationRunnerCfg
    from stripe_newton.rl.training_state import restore_statistics

    kind = DistillationRunner if isinstance(configs.agent, RslRlDistillationRunnerCfg) else OnPolicyRunner
    runner = kind(build_env(task, configs, render), configs.agent, log_dir)
    if checkpoint is not None:
        runner.load(checkpoint, load_cfg=runner.parts_to_act)
        restore_statistics(runner.env.unwrapped, checkpoint)
    return runner


def build_env(task: str, configs: Configs, render: bool = False) -> RslRlVecEnvWrapper:
    """The wrapped environment of a task, able to render if that is wanted."""
    from stripe_newton.rl import RslRlVecEnvWrapper

    wp.config.log_level = wp.LOG_WARNING  # not a line for every kernel
    print(
        f"{task}: building {configs.env.scene.num_envs} environments on {configs.env.sim.device}"
        " (the first time kernels are compiled, which takes minutes)",
        file=sys.stderr,
        flush=True,
    )
    clip = None if configs.agent is None else configs.agent.clip_actions
    return RslRlVecEnvWrapper(make_env(task, configs.env, "rgb_array" if render else None), clip)


def learn_nothing(agent: Any) -> None:
    """Let few environments do: no mini-batches are made of their samples."""
    if hasattr(agent.algorithm, "num_mini_batches"):
        agent.algorithm.num_mini_batches = 1


def find_policy(given: str | None, task: str) -> tuple[Path | None, RunFolder | None]:
    """The checkpoint or exported policy that ``--checkpoint`` means, and the run it is of.

    An exported policy may be of a run of another task, whose configs are then not asked for.
    """
    if given is None:
        return None, None
    file = find_checkpoint(given)
    folder = RunFolder.of_checkpoint(file)
    if folder is not None and file.suffix == ".onnx" and folder.read_task() not in (task, task.replace("-Play-", "-")):
        folder = None
    return file, folder


def build_policy(
    task: str, configs: Configs, checkpoint: Path, render: bool = False
) -> tuple[RslRlVecEnvWrapper, Policy]:
    """The environment of a task and a trained policy: of a checkpoint, or an exported one (``.onnx``)."""
    if checkpoint.suffix != ".onnx":
        runner = build(task, configs, render=render, checkpoint=checkpoint)
        return runner.env, runner.get_inference_policy(runner.device)
    from stripe_newton.rl import OnnxPolicy

    env = build_env(task, configs, render)
    try:
        return env, OnnxPolicy(checkpoint, env)
    except BaseException:
        env.close()
        raise


def program() -> str:
    """The words that start this program in a shell: its name where that is found, else where it lies."""
    if shutil.which("stripe-newton"):
        return "stripe-newton"
    started = Path(sys.argv[0])
    if started.name != "stripe-newton":
        return shlex.join([sys.executable, "-m", "stripe_newton.cli"])
    return shlex.quote(os.path.relpath(started))


def command(*words: str) -> str:
    """A command of this program as one would type it, with the ``--import`` that this one was given."""
    return f"{program()} {shlex.join([*words, *import_options()])}"


def video_steps(env: RslRlVecEnvWrapper) -> int:
    """Steps of a video: an episode, but not longer than ``VIDEO_SECONDS``."""
    return max(1, min(int(env.max_episode_length), round(VIDEO_SECONDS / env.unwrapped.step_dt)))
