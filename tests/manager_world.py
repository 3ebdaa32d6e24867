# SPDX-License-Identifier: Apache-2.0
"""A scene with a context for managers, without an environment."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp

from stripe_newton.fusion import Plan, Stage
from stripe_newton.managers import ManagerContext
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, Simulation, SimulationCfg
from stripe_tasks.robots import ANT_CFG, CARTPOLE_CFG

ROBOTS = {"ant": ANT_CFG, "cartpole": CARTPOLE_CFG}


def manager_context(
    num_envs: int = 4,
    robot: str = "ant",
    objects: dict[str, Any] | None = None,
    num_terminations: int = 0,
    seed: int = 0,
    observables: tuple[str, ...] = (),
) -> ManagerContext:
    """A context over a scene of one robot, and rigid objects if given, at 60 Hz with episodes of 1 s."""
    cfg = SimulationCfg(device="cpu", dt=1.0 / 120.0, solver=MuJoCoSolverCfg(), observables=observables)
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=num_envs, env_spacing=4.0), Simulation(cfg))
    with scene.construction():
        scene.builder.build_robot("robot", ROBOTS[robot].replace(prim_path="{ENV_REGEX_NS}/Robot"))
        if objects:
            scene.builder.build_objects(objects)
    scene.clone_environments()
    scene.build()
    context = ManagerContext(
        scene,
        step_dt=1.0 / 60.0,
        decimation=2,
        max_episode_length_s=1.0,
        max_episode_length=60,
        num_terminations=num_terminations,
    )
    context.seed(seed)
    nonfinite = context.array("nonfinite", wp.bool)
    context.scope.name("nonfinite", nonfinite)
    return context


def run(context: ManagerContext, *item_lists: list[Any]) -> None:
    """Fuse, compile and run items once, as a step would."""
    assert not context.problems, context.problems
    stages = [Stage(f"part {i}", items) for i, items in enumerate(item_lists)]
    Plan("test", stages, context.scope, context.num_envs, context.device, use_graph=False).run()


def plan(context: ManagerContext, *item_lists: list[Any]) -> Plan:
    """The same as a plan, to be run several times."""
    assert not context.problems, context.problems
    stages = [Stage(f"part {i}", items) for i, items in enumerate(item_lists)]
    return Plan("test", stages, context.scope, context.num_envs, context.device, use_graph=False)


def set_reset(context: ManagerContext, mask: list[bool] | torch.Tensor) -> None:
    """Say whose episodes just ended."""
    wp.to_torch(context.reset)[:] = torch.as_tensor(mask)
