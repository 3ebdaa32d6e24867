# SPDX-License-Identifier: Apache-2.0
"""Environment of a command, and the runner or the policy that acts in it."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from stripe_newton.rl import RslRlOnPolicyRunnerCfg, RunFolder, find_checkpoint
from stripe_newton.rl.configs import RunnerCfg
from stripe_newton.rl.distributed import world
from stripe_newton.rl.torch_vector_env import rl_env_of
from stripe_newton.sim.device import resolve_device
from stripe_newton.threads import choose_threads

from .compile_log import CompileLog
from .kernel_warmup import warm_up
from .run_configs import Configs, is_same_task
from .tasks import make_env
from .user_error import user_code

if TYPE_CHECKING:
    from stripe_newton.rl import OnPolicyRunner, Policy, RslRlVecEnvWrapper

__all__ = ["build", "build_env", "build_policy", "find_policy"]

# rsl_rl takes a second to import and is imported within functions here: `bench` has no use for it.


def build(
    task: str, configs: Configs, log_dir: Path | None = None, render: bool = False, checkpoint: Path | None = None
) -> OnPolicyRunner:
    """Build the environment and the runner of a task.

    Args:
        task: The task.
        configs: Its configs, with that of the agent.
        log_dir: The run folder; None writes no files.
        render: Whether the environment can draw pictures.
        checkpoint: A checkpoint whose policy is loaded.
    """
    from stripe_newton.rl import DistillationRunner, OnPolicyRunner, RslRlDistillationRunnerCfg
    from stripe_newton.rl.runner_settings import foreign_classes
    from stripe_newton.rl.runs.training_state import restore_normalization

    env, agent = build_env(task, configs, render), configs.need_agent()
    if isinstance(agent, RslRlDistillationRunnerCfg):
        # A student that only acts needs no teacher, whose run may be gone.
        agent = agent if checkpoint is None else agent.replace(teacher_checkpoint="")
        kind: type[OnPolicyRunner] = DistillationRunner
    else:
        kind = OnPolicyRunner
    foreign = ", ".join(foreign_classes(agent.to_rsl_rl()))
    with user_code("networks and algorithm", anywhere=True, otherwise=foreign) if foreign else nullcontext():
        runner = kind(env, agent, log_dir)
    _choose_threads(runner, agent, acts_only=checkpoint is not None)
    if checkpoint is not None:
        runner.load(checkpoint, load_cfg=runner.parts_to_act)
        restore_normalization(env.unwrapped, checkpoint)
    return runner


def _choose_threads(runner: OnPolicyRunner, agent: RunnerCfg, acts_only: bool) -> None:
    """Choose torch's threads for the networks of a runner on the CPU; ``--deterministic`` has chosen one."""
    if runner.device != "cpu" or torch.are_deterministic_algorithms_enabled():
        return
    networks, samples = list(runner.networks.values()), runner.env.num_envs
    if acts_only:
        networks = networks[:1]
    elif isinstance(agent, RslRlOnPolicyRunnerCfg):
        samples = samples * agent.num_steps_per_env // agent.algorithm.num_mini_batches
    choose_threads(sum(weights.numel() for network in networks for weights in network.parameters()) * samples)


def build_env(task: str, configs: Configs, render: bool = False) -> RslRlVecEnvWrapper:
    """Build the wrapped environment of a task; with ``render`` it can draw pictures."""
    from stripe_newton.rl import RslRlVecEnvWrapper

    device = configs.env.sim.device
    if world().rank == 0:
        count = configs.env.scene.num_envs
        print(f"{task}: building {count} environment{'s'[: count > 1]} on {device}", file=sys.stderr, flush=True)
    log = CompileLog.install()
    if world().rank == 0:
        warm_up(device or resolve_device(None))
    clip = None if configs.agent is None else configs.agent.clip_actions
    env = make_env(task, configs.env, "rgb_array" if render else None)
    log.finish()
    inner = rl_env_of(env.unwrapped)
    if inner is not None and inner.scene.scenery is not None:
        print(f"{task}: scenery {inner.scene.scenery.describe()}", file=sys.stderr, flush=True)
    wrapped = RslRlVecEnvWrapper(env, clip)
    if inner is not None:
        inner.sim.compile_ahead()  # while networks and learner are made
    return wrapped


def find_policy(given: str | None, task: str) -> tuple[Path | None, RunFolder | None]:
    """The checkpoint or exported policy that ``--checkpoint`` stands for, and its run.

    An exported policy may be of a run of another task. Its configs are then not used, and the run is None.
    """
    if given is None:
        return None, None
    file = find_checkpoint(given)
    folder = RunFolder.of_checkpoint(file)
    if folder is not None and file.suffix == ".onnx" and not is_same_task(folder.read_task(), task):
        folder = None
    return file, folder


def build_policy(
    task: str, configs: Configs, checkpoint: Path, render: bool = False
) -> tuple[RslRlVecEnvWrapper, Policy]:
    """Build the environment of a task, and a trained policy from a checkpoint or an exported file (``.onnx``)."""
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
