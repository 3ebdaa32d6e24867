# SPDX-License-Identifier: Apache-2.0
"""A scene here, a task there: what an environment to train in is made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import DefaultEventsCfg, ManagerBasedRLEnv, ManagerBasedRLEnvCfg
from stripe_newton.registration import register_task
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.sim import SimulationCfg
from stripe_newton.viewers import ViewerCfg

from .scene_spec import SceneSpec

__all__ = ["TaskEnvCfg", "TrainingSpec"]


class _Copies:
    """Makes copies of a config; gymnasium copies what is registered, which this need not be."""

    def __init__(self, cfg: TaskEnvCfg):
        self._cfg = cfg

    def __call__(self) -> TaskEnvCfg:
        return self._cfg.copy()

    def __deepcopy__(self, memo: dict[int, Any]) -> _Copies:
        return self


@configclass
class TaskEnvCfg(ManagerBasedRLEnvCfg):
    """Config of an environment that a :class:`TrainingSpec` made."""

    def register(
        self,
        task_id: str,
        rsl_rl_cfg: str | Callable[[], Any] | None = None,
        env: str | Callable[..., Any] = ManagerBasedRLEnv,
    ) -> str:
        """Register it with gymnasium; every environment gets a copy of this config.

        Args:
            task_id: Such as ``"My-Forest-v0"``.
            rsl_rl_cfg: What makes the config that rsl_rl trains it with, or its ``"module:Class"``.
            env: Class of the environment.

        Returns:
            ``task_id``.
        """
        register_task(task_id, env=env, env_cfg=_Copies(self), rsl_rl_cfg=rsl_rl_cfg)
        return task_id


@dataclass
class TrainingSpec:
    """What is trained, and where. Either is swapped without touching the other: ``replace(spec, scene=other)``.

    Attributes:
        scene: Where.
        robot: Who.
        observations: Observation groups, as in ``ManagerBasedRLEnvCfg``; the others likewise.
        sensors: Sensor configs by name.
        obstacles: How robots touch what stands in the scene: by collider slots, so that a step costs the same however
            much there is; terms take it as ``obstacles``. None: every collider is a shape of its own.
        assets: Further assets by name.
        sim: Time step and solver.
        num_envs: Number of environments.
        env_spacing: Distance between their origins [m].
    """

    scene: SceneSpec
    robot: ArticulationCfg
    observations: Any
    actions: Any
    rewards: Any
    terminations: Any
    events: Any = field(default_factory=DefaultEventsCfg)
    commands: Any = None
    curriculum: Any = None
    metrics: Any = None
    sensors: Mapping[str, Any] = field(default_factory=dict)
    obstacles: ObstaclesCfg | None = None
    assets: Mapping[str, Any] = field(default_factory=dict)
    sim: SimulationCfg = field(default_factory=SimulationCfg)
    num_envs: int = 4096
    env_spacing: float = 2.0

    def to_env_cfg(
        self,
        viewer: ViewerCfg | None = None,
        decimation: int = 4,
        episode_length_s: float = 20.0,
        seed: int = 0,
        debug_models: bool = False,
    ) -> TaskEnvCfg:
        """The config of the environment. The scene is made when the environment is.

        Args:
            viewer: Camera of videos.
            decimation: Physics steps in an environment step.
            episode_length_s: Duration of an episode [s].
            seed: Seed of the scene: ``cfg.scene.scenery.spawn.seed``.
            debug_models: Whether markers are part of the scene.

        Raises:
            ValueError: if a sensor and an asset have one name.
        """
        factory = self.scene.create_instance(self.num_envs, self.env_spacing, debug_models, seed)
        for name, cfg in self.assets.items():
            factory.add_asset(name, cfg)
        if self.obstacles is not None:
            factory.add_sensor("obstacles", self.obstacles.replace(of_scenery=True))
        for name, cfg in self.sensors.items():
            factory.add_sensor(name, cfg)
        managers = ("observations", "actions", "rewards", "terminations", "events", "commands", "curriculum", "metrics")
        return TaskEnvCfg(
            viewer=viewer or ViewerCfg(),
            sim=self.sim,
            decimation=decimation,
            episode_length_s=episode_length_s,
            scene=factory.get_scene(self.robot),
            **{name: getattr(self, name) for name in managers},
        )
