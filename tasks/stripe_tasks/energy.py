# SPDX-License-Identifier: Apache-2.0
"""Energy manager: what the motors of a robot take from its battery, for rewards, terminations and observations.

A manager of a user's own, made of kernels alone, so that it is part of the step's graph::

    managers = {"energy": EnergyManagerCfg(budget=5000.0, heat=0.3)}
    rewards = {"energy": RewardTermCfg(func=cost_of_transport, weight=-0.1)}
    terminations = {"empty": TerminationTermCfg(func=battery_empty)}
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_kernels.term_info import writes
from stripe_newton.configclass import configclass
from stripe_newton.fusion import Item, SceneEntityCfg
from stripe_newton.managers import CustomManager, CustomManagerCfg, ManagerContext

__all__ = [
    "EnergyData",
    "EnergyManager",
    "EnergyManagerCfg",
    "battery_empty",
    "cost_of_transport",
    "energy_left",
    "power",
]


@wp.struct
class EnergyData:
    """Energy of each environment, as terms read it."""

    power: wp.array[float]
    """Power that the motors take at the end of the last step [W], shape ``(num_envs,)``."""
    used: wp.array[float]
    """Energy taken since the start of the episode [J], shape ``(num_envs,)``."""
    travelled: wp.array[float]
    """Horizontal way of the root since the start of the episode [m], shape ``(num_envs,)``."""
    budget: wp.array[float]
    """Energy of a full battery [J], shape ``(1,)``."""
    weight: wp.array[float]
    """Weight of the robot [N], shape ``(1,)``."""


@wp.func
def measure_energy(
    env: int,
    energy: EnergyData,
    robot: ArticulationData,
    joint_ids: wp.array[int],
    step_dt: float,
    regeneration: float,
    heat: float,
) -> None:
    """Add what the motors took in a step.

    Formula: ``P = sum_i max(tau_i qd_i, 0) - regeneration max(-tau_i qd_i, 0) + heat tau_i^2`` [W] at the end of the
    step, ``E += P dt`` [J].
    """
    total = wp.float32(0.0)
    for k in range(joint_ids.shape[0]):
        joint = joint_ids[k]
        effort = robot.joint_drive_effort[env, joint] + robot.joint_other_effort[env, joint]
        mechanical = effort * robot.joint_vel[env, joint]
        total += wp.max(mechanical, 0.0) - regeneration * wp.max(-mechanical, 0.0) + heat * effort * effort
    energy.power[env] = total
    energy.used[env] = energy.used[env] + total * step_dt
    velocity = robot.root_vel[env]
    energy.travelled[env] = energy.travelled[env] + wp.length(wp.vec2(velocity[0], velocity[1])) * step_dt


@wp.func
def clear_energy(env: int, energy: EnergyData) -> None:
    """Begin an episode with a full battery."""
    energy.power[env] = 0.0
    energy.used[env] = 0.0
    energy.travelled[env] = 0.0


@wp.func
def power(env: int, energy: EnergyData) -> float:
    """Reward, usually a penalty: power that the motors take [W]."""
    return energy.power[env]


@wp.func
def cost_of_transport(env: int, energy: EnergyData, robot: ArticulationData, least_speed: float = 0.1) -> float:
    """Reward, usually a penalty: cost of transport at this moment, energy for each metre and newton of weight.

    Formula: ``P / (m g max(|v_xy|, least_speed))``.

    Source: Tucker, "The energetic cost of moving about", American Scientist 63, 1975.
    """
    velocity = robot.root_vel[env]
    speed = wp.max(wp.length(wp.vec2(velocity[0], velocity[1])), least_speed)
    return energy.power[env] / (energy.weight[0] * speed)


@writes(1)
@wp.func
def energy_left(env: int, energy: EnergyData, out: wp.array[float]) -> None:
    """Observation: charge of the battery, from 1 to 0."""
    out[0] = wp.max(1.0 - energy.used[env] / energy.budget[0], 0.0)


@wp.func
def battery_empty(env: int, energy: EnergyData) -> bool:
    """Termination: the battery is empty."""
    return energy.used[env] >= energy.budget[0]


class EnergyManager(CustomManager):
    """Measures the energy that a robot's motors take, by sampling power at the end of each step.

    ``Energy/used`` [J], ``Energy/travelled`` [m] and ``Energy/cost_of_transport`` are logged for episodes that end.

    Attributes:
        data: The struct that terms read.
        used: Energy taken in the episode [J], shape ``(num_envs,)``.
        power: Power at the end of the last step [W], shape ``(num_envs,)``.
    """

    functions: ClassVar[Sequence[wp.Function]] = (measure_energy,)
    cfg: EnergyManagerCfg

    def __init__(self, name: str, cfg: EnergyManagerCfg, context: ManagerContext):
        super().__init__(name, cfg, context)
        self.data = data = EnergyData()
        data.power, data.used, data.travelled = (self.array(n, float) for n in ("power", "used", "travelled"))
        data.budget = context.shared(f"managers.{name}.budget", float, 1, fill=cfg.budget)
        data.weight = context.shared(f"managers.{name}.weight", float, 1, fill=self._weight())
        self.provide(data)
        self.used, self.power = wp.to_torch(data.used), wp.to_torch(data.power)

    def _weight(self) -> float:
        """Weight of the robot as it was built [N]."""
        robot = self.context.asset(self.cfg.asset_name)
        gravity = torch.as_tensor(self.context.scene.sim.model.gravity.numpy()[0])
        return float(robot.native_data.default_mass[0].sum()) * float(gravity.norm())

    def physics_items(self) -> list[Item]:
        cfg = self.cfg
        entity = SceneEntityCfg(cfg.asset_name, joint_names=list(cfg.joint_names))
        return [self.call(measure_energy, robot=entity, regeneration=cfg.regeneration, heat=cfg.heat)]

    def log_items(self) -> list[Item]:
        code, energy = self.context.code, self.context.scope.name(self.name, self.data)
        transport = "{used}[env] / ({weight}[0] * wp.max({way}[env], 1.0e-3))"
        fields = {"used": energy.field("used"), "way": energy.field("travelled"), "weight": energy.field("weight")}
        return [
            self.log("Energy/used", code("{used}[env]", **fields)),
            self.log("Energy/travelled", code("{way}[env]", **fields)),
            self.log("Energy/cost_of_transport", code(transport, **fields)),
        ]

    def reset_items(self) -> list[Item]:
        return [self.call(clear_energy)]


@configclass
class EnergyManagerCfg(CustomManagerCfg):
    """Config of the energy manager."""

    class_type: type[CustomManager] = EnergyManager
    asset_name: str = "robot"
    """Robot whose energy is measured."""
    joint_names: Sequence[str] = (".*",)
    """Expressions for its driven joints."""
    budget: float = 1.0e4
    """Energy of a full battery [J]."""
    regeneration: float = 0.0
    """Share of the power of braking motors that flows back."""
    heat: float = 0.0
    """Power lost as heat for a squared effort [W/(N m)^2 or W/N^2], which is the winding's resistance over the square
    of the torque constant."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (math.isfinite(self.budget) and self.budget > 0.0):
            yield "budget", f"is {self.budget}, must be a positive energy [J]"
        if not 0.0 <= self.regeneration <= 1.0:
            yield "regeneration", f"is {self.regeneration}, must be in [0, 1]"
        if not self.heat >= 0.0:
            yield "heat", f"is {self.heat}, must not be negative"
