# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton inspect``: shows what is in a USD stage or a task, as tables and a picture."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro
import warp as wp

from stripe_newton.rl.torch_vector_env import rl_env_of

from .device import set_device, set_seeds
from .env_and_policy import build_env
from .run_configs import Configs
from .tasks import find_task, load_cfg
from .user_error import UserError

if TYPE_CHECKING:
    from stripe_newton.usd import StageReport

__all__ = ["InspectArgs", "run"]

_STAGE_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


@dataclass
class _Inspection:
    facts: dict[str, object]
    """Rows of the table, by name."""
    reports: list[StageReport]
    """Reports of the files: what was read, and what was not."""
    picture: np.ndarray
    """uint8 ``(height, width, 3)``."""


@dataclass
class InspectArgs:
    """Show what is in a USD stage, or in one environment of a task: tables and a picture."""

    target: tyro.conf.Positional[str]
    """A USD file, or a task of 'stripe-newton list'."""
    out: Path = Path(".")
    """Folder that the picture is written to."""
    json: bool = False
    """Print a JSON object in place of the tables."""


def run(argv: list[str]) -> int:
    """Run the command."""
    from stripe_newton.viewers import save_image  # here, as --help needs none of it; the same below

    args = tyro.cli(InspectArgs, args=argv, prog="stripe-newton inspect")
    wp.config.log_level = wp.LOG_WARNING
    is_stage = Path(args.target).suffix.lower() in _STAGE_SUFFIXES or Path(args.target).is_file()
    found = _inspect_stage(Path(args.target)) if is_stage else _inspect_task(args.target)
    path = args.out / f"{Path(args.target).stem if is_stage else args.target}.png"
    save_image(path, found.picture)
    if args.json:
        reports = [report.to_dict() for report in found.reports]
        content = {"name": args.target, **found.facts, "picture": str(path), "reports": reports}
        print(json_module.dumps(content, indent=2))
        return 0
    width = max(map(len, found.facts), default=0) + 2
    for name, value in found.facts.items():
        lines = str(value).splitlines()
        print(f"{name:<{width}}" + f"\n{'':<{width}}".join(lines))
    for report in found.reports:
        print(("\n" if found.facts else "") + report.to_text())
    print(f"picture: {path}")
    return 0


def _inspect_stage(path: Path) -> _Inspection:
    """The report and a picture of a stage, which says nothing about a task."""
    from stripe_newton.scene import InteractiveScene
    from stripe_newton.sim import SimulationCfg
    from stripe_newton.usd import inspect_stage
    from stripe_newton.viewers import SceneRenderer, ViewerCfg

    report = inspect_stage(path)
    scene = InteractiveScene.from_usd(path, sim_cfg=SimulationCfg(gravity=None, device="cpu"))
    try:
        return _Inspection({}, [report], SceneRenderer(scene.sim, ViewerCfg()).render())
    finally:
        scene.close()


def _inspect_task(task: str) -> _Inspection:
    """Sizes, rates and stages of a task, the reports of its assets, and a picture of its first environment.

    Raises:
        UserError: if there is no such task, or its environment is not one of this package.
    """
    try:
        find_task(task)
    except UserError as error:
        raise UserError(f"{error}; nor is there a file of that name") from None
    cfg = load_cfg(task, "env")
    cfg.scene.num_envs = 1
    set_device(cfg, None)
    set_seeds(cfg.seed or 0)
    env = build_env(task, Configs(cfg, None), render=True)
    try:
        env.reset()
        inner = rl_env_of(env.unwrapped)
        if inner is None:
            raise UserError(f"{task}: {type(env.unwrapped).__name__} is not an environment of this package")
        facts = {
            "task": task,
            "device": str(env.device),
            "physics": inner.sim.describe_solver(),
            "physics_dt": inner.physics_dt,
            "decimation": cfg.decimation,
            "step_dt": inner.step_dt,
            "max_episode_length": int(env.max_episode_length),
            "observations": {name: list(space.shape) for name, space in env.unwrapped.single_observation_space.items()},
            "actions": env.num_actions,
            "step": inner.describe(),
        }
        picture = inner.render()
        assert picture is not None  # it was built to draw pictures
        return _Inspection(facts, list(inner.scene.builder.reports), picture)
    finally:
        env.close()
