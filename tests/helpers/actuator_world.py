# SPDX-License-Identifier: Apache-2.0
"""Robot of sliders with an actuator of each kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from stripe_newton.actuators import (
    DCMotorCfg,
    DelayedPDActuatorCfg,
    IdealPDActuatorCfg,
    ImplicitActuatorCfg,
    PIDActuatorCfg,
    RemotizedPDActuatorCfg,
)
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import ResetMask
from tests.helpers.small_scenes import make_scene, mjcf_robot, sliders

KP, KD, LIMIT = 50.0, 3.0, 6.0
KI, I_MAX = 400.0, 0.004
SATURATION, NO_LOAD = 9.0, 2.0
LATE = 1, 5
TABLE = [[-0.5, 1.0, 1.0], [0.0, 1.0, 4.0], [0.2, 1.0, 2.0], [0.6, 1.0, 3.0]]
"""Position, ratio, effort."""

GAINS = {"stiffness": KP, "damping": KD, "effort_limit": LIMIT}
KINDS: dict[str, Any] = {
    "solver": ImplicitActuatorCfg(joint_names_expr=["solver"], **GAINS),
    "pd": IdealPDActuatorCfg(joint_names_expr=["pd"], **GAINS),
    "pid": PIDActuatorCfg(joint_names_expr=["pid"], integral_gain=KI, integral_limit=I_MAX, **GAINS),
    "motor": DCMotorCfg(
        joint_names_expr=["motor"], saturation_effort=SATURATION, velocity_limit={"mo.*": NO_LOAD}, **GAINS
    ),
    "late": DelayedPDActuatorCfg(joint_names_expr=["late", "later"], min_delay=LATE[0], max_delay=LATE[1], **GAINS),
    "remote": RemotizedPDActuatorCfg(
        joint_names_expr=["remote"], stiffness=KP, damping=KD, max_delay=3, joint_parameter_lookup=TABLE
    ),
}
"""By name of the group and of its first joint."""
JOINTS = ["remote", "solver", "pd", "later", "pid", "motor", "late"]
"""In an order of their own."""


def actuator_scene(
    folder: Path, kinds: dict[str, Any] = KINDS, joints: list[str] = JOINTS, num_envs: int = 4, **changes: Any
) -> InteractiveScene:
    """A scene of one robot, ``"robot"``, whose joints slide without touching."""
    text = sliders(dict.fromkeys(joints, "1 0 0"))
    return make_scene({"robot": mjcf_robot(folder, text, actuators=kinds)}, num_envs=num_envs, **changes)


class Drill:
    """Draws states and targets of the robot, the same for an environment whatever their number."""

    def __init__(self, scene: InteractiveScene, seed: int = 0):
        self.robot, self.sim = scene["robot"], scene.sim
        self._streams = [np.random.default_rng([seed, env]) for env in range(scene.num_envs)]

    def draw(self, scale: float) -> torch.Tensor:
        """Uniform in ``+-scale``, shape ``(num_envs, num_joints)``."""
        rows = [stream.uniform(-scale, scale, self.robot.num_joints) for stream in self._streams]
        return torch.tensor(np.array(rows), dtype=torch.float32)

    def targets(self) -> None:
        """Draw targets."""
        self.robot.set_joint_position_target(self.draw(0.3))
        self.robot.set_joint_velocity_target(self.draw(1.0))
        self.robot.set_joint_effort_target(self.draw(2.0))

    def state(self) -> None:
        """Draw positions and velocities."""
        self.robot.write_joint_state_to_sim(self.draw(0.7), self.draw(3.0))


def reset_mask(scene: InteractiveScene, envs: list[int]) -> ResetMask:
    """Mask of some environments, as a step's."""
    mask = ResetMask(scene.num_envs, scene.sim.device)
    mask.tensor[envs] = True
    return mask
