# SPDX-License-Identifier: Apache-2.0
"""Training specification: a scene, a robot and a task, combined into the config of an environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import DefaultEventsCfg, ManagerBasedRLEnv, ManagerBasedRLEnvCfg
from stripe_newton.registration import register_task
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.sim import SimulationCfg
from stripe_newton.viewers import ViewerCfg

from .scene_cfg_factory import SceneEntryCfg
from .scene_spec import SceneSpec

__all__ = ["TaskEnvCfg", "TrainingSpec"]

TermsCfg: TypeAlias = Any
"""Config of a manager: a config class with a field for each term, or a dict of terms. Type checkers accept any field of
it, as each task has its own."""


class _CopyMaker:
    """Makes copies of a config.

    Gymnasium copies the arguments of a registered environment each time it is looked up. That must not copy the
    config, which may hold a large scene.
    """

    def __init__(self, cfg: TaskEnvCfg):
        self._cfg = cfg

    def __call__(self) -> TaskEnvCfg:
        return self._cfg.copy()

    def __deepcopy__(self, memo: dict[int, object]) -> _CopyMaker:
        return self


@configclass
class TaskEnvCfg(ManagerBasedRLEnvCfg):
    """Config of an environment, made by a :class:`TrainingSpec`."""

    def register(
        self,
        task_id: str,
        rsl_rl_cfg: str | Callable[[], object] | None = None,
        env: str | Callable[..., ManagerBasedRLEnv] = ManagerBasedRLEnv,
    ) -> str:
        """Register a task with gymnasium; every environment gets a copy of this config.

        Args:
            task_id: Such as ``"My-Forest-v0"``.
            rsl_rl_cfg: Class or function that makes the rsl_rl config, or its ``"module:name"``. None: no such config.
            env: Class of the environment, or its ``"module:Class"``.

        Returns:
            ``task_id``.
        """
        register_task(task_id, env=env, env_cfg=_CopyMaker(self), rsl_rl_cfg=rsl_rl_cfg)
        return task_id


@dataclass
class TrainingSpec:
    """A scene and a task to train in it. Each can be replaced without the other: ``replace(spec, scene=other)``.

    It takes all that an environment has: further fields are those of :class:`ManagerBasedRLEnvCfg`.

    Attributes:
        scene: The scene.
        robot: The robot.
        observations: Observation groups.
        actions: Action terms.
        rewards: Reward terms.
        terminations: Termination terms.
        events: Event terms. By default a reset brings every asset to its default state.
        commands: Command terms.
        curriculum: Curriculum terms.
        objects: Pools of rigid objects.
        metrics: Metric terms.
        recorders: Recorder terms and the file they write to.
        managers: Managers of your own by name.
        sensors: Sensor configs by name.
        obstacles: Collider slots for the assets of the scene, so that the time of a step does not depend on their
            number; terms read them as ``obstacles``. None: every collider is a shape of the model.
        assets: Further assets by name.
        sim: Time step and solver.
        num_envs: Number of environments.
        env_spacing: Distance between their origins [m].
        decimation: Physics steps in an environment step.
        episode_length_s: Duration of an episode [s].
        scene_seed: Seed of the scene.
        seed: Seed of the environment's random numbers.
        viewer: Camera of videos.
    """

    scene: SceneSpec
    robot: ArticulationCfg
    observations: TermsCfg
    actions: TermsCfg
    rewards: TermsCfg
    terminations: TermsCfg
    events: TermsCfg = field(default_factory=DefaultEventsCfg)
    commands: TermsCfg = None
    curriculum: TermsCfg = None
    objects: TermsCfg = None
    metrics: TermsCfg = None
    recorders: TermsCfg = None
    managers: TermsCfg = None
    sensors: Mapping[str, SceneEntryCfg] = field(default_factory=dict)
    obstacles: ObstaclesCfg | None = None
    assets: Mapping[str, SceneEntryCfg] = field(default_factory=dict)
    sim: SimulationCfg = field(default_factory=SimulationCfg)
    num_envs: int = 4096
    env_spacing: float = 2.0
    decimation: int = 4
    episode_length_s: float = 20.0
    scene_seed: int = 0
    seed: int | None = None
    viewer: ViewerCfg = field(default_factory=ViewerCfg)
    keep_at_reset: Sequence[str] = ()
    scale_rewards_by_dt: bool = True
    is_finite_horizon: bool = False
    nonfinite_actions: str = "raise"
    compute_final_obs: bool = False

    def register(
        self,
        task_id: str,
        rsl_rl_cfg: str | Callable[[], object] | None = None,
        env: str | Callable[..., ManagerBasedRLEnv] = ManagerBasedRLEnv,
    ) -> str:
        """Register the task with gymnasium; see :meth:`TaskEnvCfg.register`."""
        return self.to_env_cfg().register(task_id, rsl_rl_cfg, env)

    def to_env_cfg(
        self,
        viewer: ViewerCfg | None = None,
        decimation: int | None = None,
        episode_length_s: float | None = None,
        seed: int | None = None,
        debug_models: bool = False,
    ) -> TaskEnvCfg:
        """The config of the environment. The scene is generated when the environment is made.

        Args:
            viewer: Overrides the field of this name, as do the next two.
            decimation: Physics steps in an environment step.
            episode_length_s: Duration of an episode [s].
            seed: Overrides ``scene_seed``; it becomes ``cfg.scene.scenery.spawn.seed``.
            debug_models: Whether the scene contains markers.

        Raises:
            ValueError: if a sensor and an asset have one name.
        """
        scene_seed = self.scene_seed if seed is None else seed
        factory = self.scene.create_instance(self.num_envs, self.env_spacing, debug_models, scene_seed)
        for name, cfg in self.assets.items():
            factory.add_asset(name, cfg)
        if self.obstacles is not None:
            # The colliders are then those of the scene's assets, whatever the config says of positions.
            factory.add_sensor("obstacles", self.obstacles.replace(of_scenery=True))
        for name, cfg in self.sensors.items():
            factory.add_sensor(name, cfg)
        given = {"viewer": viewer, "decimation": decimation, "episode_length_s": episode_length_s}
        values = {name: getattr(self, name) for name in _ENV_FIELDS}
        values |= {name: value for name, value in given.items() if value is not None}
        return TaskEnvCfg(scene=factory.get_scene(self.robot), **values)


_ENV_FIELDS = [n for n in TaskEnvCfg.__dataclass_fields__ if n in TrainingSpec.__dataclass_fields__ and n != "scene"]
"""Fields of the environment that are taken over as they are."""
