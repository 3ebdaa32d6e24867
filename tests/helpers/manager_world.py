# SPDX-License-Identifier: Apache-2.0
"""Scene with a context for managers, without an environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp

from stripe_newton.configclass import configclass
from stripe_newton.fusion import Plan, Stage
from stripe_newton.managers import ManagerContext, ObservationGroupCfg, ObservationManager
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
    context.reset_mask.begin_step()
    wp.to_torch(context.reset)[:] = torch.as_tensor(mask)


def observation_group(terms: dict[str, Any], **fields: Any) -> ObservationGroupCfg:
    """A group of observations of these terms."""
    made: ObservationGroupCfg = configclass(type("Group", (ObservationGroupCfg,), dict(terms)))(**fields)
    return made


class ObservationWorld:
    """An observation manager on a robot whose joint positions are what a test says."""

    def __init__(
        self, groups: dict[str, Any], num_envs: int = 4, robot: str = "ant", seed: int = 3, where_reset: bool = False
    ):
        self.context = context = manager_context(num_envs, robot, seed=seed)
        context.owner = context
        self.robot = context.entity("robot").data.struct
        self.manager = ObservationManager(groups, context)
        self.items = self.manager.compute_items()
        self._compute = plan(context, self.items)
        self._reset = plan(context, self.manager.reset_items())
        self._where_reset = plan(context, self.manager.compute_items(where_reset=True)) if where_reset else None

    def step(self, joint_pos: Any = None) -> None:
        """Move the joints, then observe."""
        if joint_pos is not None:
            self.context.torch(self.robot.joint_pos)[:] = torch.as_tensor(joint_pos, dtype=torch.float32)
        self._compute.run()

    def reset(self, *envs: int) -> None:
        """Start new episodes in some environments."""
        set_reset(self.context, [i in envs for i in range(self.context.num_envs)])
        self._reset.run()

    def observe_ended(self, *envs: int) -> None:
        """Observe only the environments whose episode ended."""
        assert self._where_reset is not None
        set_reset(self.context, [i in envs for i in range(self.context.num_envs)])
        self._where_reset.run()

    def __getitem__(self, name: str) -> np.ndarray:
        """A copy of a group, or of ``GROUP.TERM`` of one that is not concatenated."""
        values: np.ndarray = self.manager.flat_buffers()[name].numpy().copy()
        return values

    def state(self) -> dict[str, np.ndarray]:
        """A copy of all arrays that last from step to step."""
        return {name: array.numpy().copy() for name, array in self.context.arrays.items()}
