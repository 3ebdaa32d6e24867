# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton export``: writes a trained policy as ONNX and TorchScript files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from stripe_newton.rl import RunFolder, export_policy, find_checkpoint

from .device import set_device, set_seeds
from .env_and_policy import build
from .run_configs import check, load_configs, use_one_minibatch
from .tasks import find_task
from .user_error import UserError

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnvCfg

__all__ = ["ExportArgs", "run"]


@dataclass
class ExportArgs:
    """Write a policy as ONNX and TorchScript, with what a robot has to know, and check both against it."""

    target: tyro.conf.Positional[str]
    """A run folder, of which the newest checkpoint is taken, or a checkpoint file."""
    out: tyro.conf.DisallowNone[Path | None] = None
    """Folder for the files; by default the run's 'exported', or the checkpoint's own folder."""
    task: tyro.conf.DisallowNone[str | None] = None
    """The task, for a checkpoint that lies in no run folder."""
    mjcf: bool = False
    """Also write robot.xml, the scene of one environment for plain MuJoCo."""
    device: tyro.conf.DisallowNone[str | None] = None
    """cpu or cuda:N; by default the first GPU where there is one."""


def run(argv: list[str]) -> int:
    """Run the command."""
    args = tyro.cli(ExportArgs, args=argv, prog="stripe-newton export")
    checkpoint = find_checkpoint(args.target)
    folder = RunFolder.of_checkpoint(checkpoint)
    task = args.task or (folder.read_task() if folder is not None else None)
    if task is None:
        raise UserError(f"{checkpoint}: is in no run folder that names its task; give --task TASK")
    find_task(task)
    configs = load_configs(task, folder)
    configs.env.scene.num_envs = 1
    use_one_minibatch(configs.need_agent())
    set_device(configs.env, args.device)
    out = args.out or (folder.exported if folder is not None else checkpoint.parent)
    robot = _request_mjcf(configs.env, out) if args.mjcf else None
    check(configs)
    set_seeds(configs.env.seed or 0)

    runner = build(task, configs, checkpoint=checkpoint)
    try:
        print(export_policy(runner, out, task=task, run=folder.path.name if folder is not None else None))
    finally:
        runner.env.close()
    if robot is not None:
        print(f"{robot}  {robot.stat().st_size:,} bytes")
    return 0


def _request_mjcf(cfg: RLEnvCfg, out: Path) -> Path:
    """Set the solver's config so that it writes what it simulates as MJCF, when the environment is built.

    Raises:
        UserError: if the solver is not MuJoCo.
    """
    from stripe_newton.sim import MuJoCoSolverCfg  # here, as it loads Newton, which --help does not need

    solver = getattr(cfg.sim, "solver", None)  # an environment of another package need not have one
    if not isinstance(solver, MuJoCoSolverCfg):
        raise UserError(f"--mjcf: this task runs on {type(solver).__name__}, only MuJoCoSolverCfg writes MJCF")
    out.mkdir(parents=True, exist_ok=True)
    solver.save_to_mjcf = str(out / "robot.xml")
    return out / "robot.xml"
