# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that act on a task or a run. Apart from the commands, so that help and errors are quick."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from .user_error import UserError, check_count

__all__ = ["OPTIONS", "BenchArgs", "DemoArgs", "EvalArgs", "ExportArgs", "InspectArgs", "PlayArgs", "TrainArgs"]

TaskName = Annotated[str, tyro.conf.arg(metavar="TASK")]
"""A task, named so in the help."""


@dataclass
class TrainArgs:
    """Train a policy for a task; TASK --help also shows every field of its configuration."""

    task: tyro.conf.Positional[TaskName]
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
    """Folder of the run folders: LOG_DIR/EXPERIMENT/DATE_TIME."""
    video_interval: int = 0
    """Film the training every so many iterations; 0 for one video at the end."""
    final_video: bool = True
    """Whether the trained policy is filmed at the end."""
    viewer: Literal["viser", "none"] = "none"
    """Show the training live in a browser; it is slowed only while somebody looks."""
    host: str = "127.0.0.1"
    """Address that the live view listens on; 0.0.0.0 for other machines too, which then need the printed token."""
    port: int = 8080
    """Port of the live view; the next free one if it is in use."""
    runner: tyro.conf.DisallowNone[Literal["graph", "rsl_rl"] | None] = None
    """Rollout and update as CUDA graphs where possible, or rsl_rl's own, unchanged; short for --agent.runner."""
    resume: tyro.conf.DisallowNone[str | None] = None
    """Continue a run: its folder, or a checkpoint of it. Its configuration is taken over."""
    teacher: tyro.conf.DisallowNone[str | None] = None
    """Distil the policy of this run, its folder or a checkpoint of it, for tasks whose policy learns from a teacher."""
    allow_changes: bool = False
    """Resume a run with another environment or other networks than it had."""
    gpus: tyro.conf.DisallowNone[int | None] = None
    """Train on so many GPUs of this host, one process on each; --num-envs counts the environments of all."""
    sweep: tyro.conf.DisallowNone[Path | None] = None
    """A YAML file of fields and seeds to try; a run for each, in a process of its own."""
    jobs: tyro.conf.DisallowNone[int | None] = None
    """Runs of a sweep at a time: by default one on each GPU, or one on the CPU."""
    deterministic: bool = False
    """Give the same bits in every run, and refuse what cannot; slower on a GPU."""


@dataclass
class EvalArgs:
    """Measure a trained policy: mean return and length of a number of whole episodes, without exploration."""

    task: tyro.conf.Positional[TaskName]
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
    deterministic: bool = False
    """Give the same bits in every run, and refuse what cannot; slower on a GPU."""
    json: tyro.conf.DisallowNone[Path | None] = None
    """File to write the result to."""


@dataclass
class ExportArgs:
    """Write a policy as ONNX and TorchScript, with what a robot has to know, and check both against it."""

    target: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="RUN")]]
    """A run folder, of which the newest checkpoint is taken, or a checkpoint file."""
    out: tyro.conf.DisallowNone[Path | None] = None
    """Folder for the files; by default the run's 'exported', or the checkpoint's own folder."""
    task: tyro.conf.DisallowNone[str | None] = None
    """The task, for a checkpoint that lies in no run folder."""
    mjcf: bool = False
    """Also write robot.xml, the scene of one environment for plain MuJoCo."""
    device: tyro.conf.DisallowNone[str | None] = None
    """cpu or cuda:N; by default the first GPU where there is one."""


@dataclass
class PlayArgs:
    """Watch a policy act, in a browser or as a video."""

    task: tyro.conf.Positional[TaskName]
    """The task, one of 'stripe-newton list'."""
    checkpoint: tyro.conf.DisallowNone[str | None] = None
    """A run folder, of which the newest checkpoint is taken, a checkpoint file, or an exported policy (.onnx)."""
    agent: tyro.conf.DisallowNone[Literal["zero", "random"] | None] = None
    """Actions that are zero or random, in place of a checkpoint."""
    viewer: tyro.conf.DisallowNone[Literal["viser", "video", "none"] | None] = None
    """A live view in the browser, a video file, or only numbers; by default viser where it is installed, else video."""
    num_envs: tyro.conf.DisallowNone[int | None] = None
    """Number of environments; by default 16 at most."""
    steps: tyro.conf.DisallowNone[int | None] = None
    """Stop after so many steps; by default after an episode, and with viser at Ctrl-C."""
    host: str = "127.0.0.1"
    """Address that the live view listens on; 0.0.0.0 for other machines too, which then need the printed token."""
    port: int = 8080
    """Port of the live view; the next free one if it is in use."""
    seed: tyro.conf.DisallowNone[int | None] = None
    """Seed of everything."""
    device: tyro.conf.DisallowNone[str | None] = None
    """cpu or cuda:N; by default the first GPU where there is one."""

    def check(self) -> None:
        """Check what the options alone tell.

        Raises:
            UserError: for neither or both of a checkpoint and an agent, or for no steps.
        """
        if (self.checkpoint is None) == (self.agent is None):
            raise UserError("play needs either --checkpoint RUN_OR_FILE or --agent zero|random")
        check_count("--steps", self.steps)


@dataclass
class DemoArgs:
    """Watch a trained policy that comes with its task, in a browser; on the CPU unless --device says otherwise."""

    task: tyro.conf.Positional[Annotated[tyro.conf.DisallowNone[str | None], tyro.conf.arg(metavar="[TASK]")]] = None
    """A task with a policy; by default a quadruped on flat ground."""
    viewer: Literal["viser", "none"] = "viser"
    """A live view in the browser, or only numbers."""
    num_envs: int = 4
    """Number of environments."""
    steps: tyro.conf.DisallowNone[int | None] = None
    """Stop after so many steps; by default at Ctrl-C, and without a viewer after an episode."""
    host: str = "127.0.0.1"
    """Address that the live view listens on; 0.0.0.0 for other machines too, which then need the printed token."""
    port: int = 8080
    """Port of the live view; the next free one if it is in use."""
    browser: bool = True
    """Open the page in the browser of this machine, where there is a screen."""
    seed: tyro.conf.DisallowNone[int | None] = None
    """Seed of everything."""
    device: str = "cpu"
    """cpu or cuda:N."""


@dataclass
class BenchArgs:
    """Measure a task: the whole step and the physics alone under the same random actions, CUDA calls, start-up."""

    task: tyro.conf.Positional[TaskName]
    """The task, one of 'stripe-newton list'."""
    num_envs: tyro.conf.DisallowNone[int | None] = None
    """Number of environments; by default those of the training."""
    steps: int = 320
    """Number of steps to time."""
    seed: int = 0
    """Seed of everything."""
    device: tyro.conf.DisallowNone[str | None] = None
    """cpu or cuda:N; by default the first GPU where there is one."""
    json: tyro.conf.DisallowNone[Path | None] = None
    """File to write the result to."""


@dataclass
class InspectArgs:
    """Show what is in a USD, URDF or MJCF file, or in one environment of a task: tables and a picture. A task takes
    options for the fields of its config, such as --env.scene.scenery room.usd."""

    target: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="TASK_OR_FILE")]]
    """A USD, URDF or MJCF file, or a task of 'stripe-newton list'."""
    out: Path = Path(".")
    """Folder that the picture is written to."""
    json: bool = False
    """Print a JSON object in place of the tables."""
    viewer: Literal["viser", "none"] = "none"
    """Show it in a browser, too, until Ctrl-C."""
    host: str = "127.0.0.1"
    """Address that the live view listens on; 0.0.0.0 for other machines too, which then need the printed token."""
    port: int = 8080
    """Port of the live view; the next free one if it is in use."""


OPTIONS: dict[str, type] = {
    "train": TrainArgs,
    "eval": EvalArgs,
    "export": ExportArgs,
    "play": PlayArgs,
    "bench": BenchArgs,
    "demo": DemoArgs,
    "inspect": InspectArgs,
}
"""Options by command."""
