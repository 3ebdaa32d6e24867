# SPDX-License-Identifier: Apache-2.0
"""An arm whose hand actions move, as an environment, and goals for it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.actuators import ActuatorCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_tasks.robot_scene import RobotSceneCfg
from tests.helpers.inverse_kinematics_world import (
    ARM,
)

# -- in the loop


@configclass
class Policy(ObservationGroupCfg):
    """The joints."""

    joint_pos = ObservationTermCfg(func=mdp.joint_pos)


def arm_env(
    term: Any,
    num_envs: int = 3,
    turned: float = 0.0,
    decimation: int = 2,
    weightless: bool = True,
    drives: Mapping[str, ActuatorCfg] = ARM.actuators,
) -> ManagerBasedRLEnv:
    """The arm of the reach task at 60 Hz, in its default pose, its base turned about z, with motors that have inertia:
    without, the drives of the wrist swing about a target that is far off, whoever sets it."""
    robot = ARM.replace(actuators={group: drive.copy() for group, drive in drives.items()})
    for actuator in robot.actuators.values():
        actuator.armature = 0.1
    robot.init_state.rot = (0.0, 0.0, math.sin(0.5 * turned), math.cos(0.5 * turned))
    cfg = ManagerBasedRLEnvCfg(
        decimation=decimation,
        episode_length_s=100.0,
        sim=SimulationCfg(
            device="cpu",
            dt=1.0 / 60.0,
            gravity=(0.0, 0.0, 0.0 if weightless else -9.81),
            solver=MuJoCoSolverCfg(disable_contacts=True, drive_limits=True),
        ),
        scene=RobotSceneCfg(num_envs=num_envs, env_spacing=2.5, robot=robot),
        observations={"policy": Policy()},
        actions={"arm": term},
        rewards={"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)},
        terminations={"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)},
        events={"all": EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")},
    )
    env = ManagerBasedRLEnv(cfg)
    env.reset(seed=1)
    return env


def run(env: ManagerBasedRLEnv, command: np.ndarray, seconds: float = 3.0) -> None:
    command = torch.tensor(command, dtype=torch.float32)
    for _ in range(round(seconds / env.step_dt)):
        env.step(command)


GOALS = np.array([[0.45, -0.15, 0.25], [0.35, 0.2, 0.35], [0.5, 0.05, 0.15]])
DOWN = Rotation.from_euler("zyx", [[0.4, 0.0, -math.pi / 2], [-0.5, 0.1, -1.4], [0.2, -0.1, -math.pi / 2]])
