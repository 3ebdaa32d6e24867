# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton inspect``."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
import warp as wp

from .common import Configs, build_env, set_device, set_seeds
from .errors import UserError
from .tasks import find_task, load_cfg

__all__ = ["InspectArgs", "run"]

_STAGE_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


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
    from stripe_newton.viewers import save_image

    args = tyro.cli(InspectArgs, args=argv, prog="stripe-newton inspect")
    wp.config.log_level = wp.LOG_WARNING
    is_stage = Path(args.target).suffix.lower() in _STAGE_SUFFIXES or Path(args.target).is_file()
    facts, reports, picture = _inspect_stage(Path(args.target)) if is_stage else _inspect_task(args.target)
    path = args.out / f"{Path(args.target).stem if is_stage else args.target}.png"
    save_image(path, picture)
    if args.json:
        content = {"name": args.target, **facts, "picture": str(path), "reports": [r.to_dict() for r in reports]}
        print(json_module.dumps(content, indent=2))
        return 0
    width = max(map(len, facts), default=0) + 2
    for name, value in facts.items():
        lines = str(value).splitlines()
        print(f"{name:<{width}}" + f"\n{'':<{width}}".join(lines))
    for report in reports:
        print(("\n" if facts else "") + report.to_text())
    print(f"picture: {path}")
    return 0


def _inspect_stage(path: Path) -> tuple[dict[str, Any], list[Any], Any]:
    """Nothing but the report and a picture; a stage says nothing about a task."""
    from stripe_newton.scene import InteractiveScene
    from stripe_newton.sim import SimulationCfg
    from stripe_newton.usd import inspect_stage
    from stripe_newton.viewers import SceneRenderer, ViewerCfg

    report = inspect_stage(path)
    scene = InteractiveScene.from_usd(path, sim_cfg=SimulationCfg(gravity=None, device="cpu"))
    try:
        return {}, [report], SceneRenderer(scene.sim, ViewerCfg()).render()
    finally:
        scene.close()


def _inspect_task(task: str) -> tuple[dict[str, Any], list[Any], Any]:
    """What a task's config says of a step, the reports of its assets, and a picture of its first environment."""
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
        inner = env.unwrapped
        facts = {
            "task": task,
            "device": str(env.device),
            "physics_dt": inner.physics_dt,
            "decimation": cfg.decimation,
            "step_dt": inner.step_dt,
            "max_episode_length": int(env.max_episode_length),
            "observations": {name: list(space.shape) for name, space in inner.single_observation_space.items()},
            "actions": env.num_actions,
            "step": inner.describe(),
        }
        return facts, list(inner.scene.builder.reports), env.render()
    finally:
        env.close()
