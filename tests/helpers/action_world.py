# SPDX-License-Identifier: Apache-2.0
"""Action manager on a robot in a random state, and an action term of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.managers import ActionManager, ActionTermCfg
from tests.helpers.manager_world import manager_context, plan, set_reset

N = 4
INF = np.inf
LEGS = ["front_left_leg", "front_right_leg", "left_back_leg", "right_back_leg"]
TARGETS = "joint_pos_target", "joint_vel_target", "joint_effort_target"
DRAWN = "joint_pos", "joint_vel", "default_joint_pos", "default_joint_vel", "body_pose", *TARGETS
FIELDS = *DRAWN, "joint_pos_lower", "joint_pos_upper", "root_pose"


class World:
    """An action manager on a robot in a random state."""

    def __init__(self, terms: Any, num_envs: int = N, seed: int = 3):
        self.context = context = manager_context(num_envs, seed=seed)
        self.robot = context.entity("robot").data.struct
        draw = np.random.default_rng(seed)
        for name in DRAWN:
            array = getattr(self.robot, name)
            view = context.torch(array)
            view[:] = torch.as_tensor(draw.normal(size=tuple(view.shape)), dtype=torch.float32)
        poses = context.torch(self.robot.body_pose)
        poses[..., 3:] /= poses[..., 3:].norm(dim=-1, keepdim=True)
        self.manager = ActionManager(terms, context)
        self.process_items, self.apply_items, self.reset_items = (
            self.manager.process_items(), self.manager.apply_items(), self.manager.reset_items(),
        )  # fmt: skip
        assert not context.problems, context.problems
        self._process, self._apply, self._reset = (
            plan(context, items) for items in (self.process_items, self.apply_items, self.reset_items)
        )

    def step(self, action: Any) -> None:
        self.context.torch(self.manager.input)[:] = torch.as_tensor(action)
        self._process.run()

    def substep(self) -> None:
        self._apply.run()

    def reset(self, *envs: int) -> None:
        set_reset(self.context, [i in envs for i in range(self.context.num_envs)])
        self._reset.run()

    def values(self) -> dict[str, Any]:
        """The state in float64, as the references take it."""
        found = {n: getattr(self.robot, n).numpy().astype(float) for n in FIELDS}
        return {"ArticulationData": found | {"soft_limit_factor": self.robot.soft_limit_factor}}

    def processed(self, name: str) -> np.ndarray:
        return self.context.arrays[f"actions.{name}.processed"].numpy()


BASE = {
    "body_name": "torso",
    "x_joint_name": "left_back_foot",
    "y_joint_name": "front_left_leg",
    "yaw_joint_name": "right_back_leg",
}


# -- own terms


@wp.func
def mix(env: int, action: wp.array[float], weights: wp.array[float], gain: float, processed: wp.array[float]):
    total = wp.float32(0.0)
    for i in range(action.shape[0]):
        total += weights[i] * action[i]
    processed[0] = gain * total
    processed[1] = processed[1] + 1.0


@wp.func
def push(env: int, processed: wp.array[float], robot: ArticulationData, joint_ids: wp.array[int], damping: float):
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        robot.joint_effort_target[env, joint] = processed[0] - damping * robot.joint_vel[env, joint]


@wp.func
def start(env: int, processed: wp.array[float], first: float):
    processed[1] = first


def own_term(**changes: Any) -> ActionTermCfg:
    params = {"weights": [1.0, -2.0, 0.5], "gain": 2.0, "damping": 0.1, "first": -3.0}
    cfg = ActionTermCfg(
        joint_names=["front_left_.*"],
        process=mix,
        apply=push,
        reset=start,
        action_size=3,
        processed_size=2,
        params=params,
    )
    return cfg.replace(**changes)
