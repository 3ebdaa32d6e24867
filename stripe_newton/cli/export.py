# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton export``: writes a trained policy as ONNX and TorchScript files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from stripe_newton.rl import RunFolder, export_policy, find_checkpoint

from .device import set_device, set_seeds
from .env_and_policy import build
from .options import ExportArgs
from .run_configs import check, load_configs, use_one_minibatch
from .tasks import find_task
from .user_error import UserError
from .written_places import try_place

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnvCfg

__all__ = ["ExportArgs", "run"]


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
    if args.out is None and folder is not None:
        folder.check_links(folder.exported)
    try_place("--out", out, folder=True)
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
