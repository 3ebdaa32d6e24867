# SPDX-License-Identifier: Apache-2.0
"""Interactive scene: assets and sensors in many environments."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from pxr import Sdf, Usd

from stripe_newton.assets import AssetBase
from stripe_newton.configclass import ConfigError
from stripe_newton.sim import Simulation, SimulationCfg
from stripe_newton.sim.scene_context import ENV_0, authored_path
from stripe_newton.usd import Ignored, StageError, ignored_text, open_stage, solver_reason, stage_name

from .builder import SceneBuilder
from .controller import SceneController
from .export import export_stage
from .new_stage import new_stage
from .querier import SceneQuerier
from .regenerator import SceneRegenerator
from .scene_contents import InteractiveSceneCfg, SceneContents

if TYPE_CHECKING:
    from stripe_newton.assets.asset_base import EnvIds

__all__ = ["InteractiveScene"]


class InteractiveScene(SceneContents):
    """Assets and sensors in many environments, on one USD stage, simulated by one model.

    It is authored first, by the fields of its config and by what is created inside :meth:`construction`
    (``_setup_scene`` of an environment). Then :meth:`build` loads the stage into Newton and replicates it.

    Attributes:
        builder: Builds the scene: assets, sensors, the model.
        controller: Changes the scene: targets, resets, dynamics.
        querier: Reads the scene: states, sensors, contacts.
    """

    env_regex_ns = "/World/envs/env_.*"
    """Prim path expression of all environments."""

    def __init__(
        self,
        cfg: InteractiveSceneCfg,
        sim: Simulation | None = None,
        stage: Usd.Stage | None = None,
        author: bool = True,
    ):
        """Author the config's assets.

        Args:
            cfg: The scene; its fields that are asset or sensor configs, or dicts of them, are spawned in order.
            sim: Simulation to build, by default a new one with default settings.
            stage: Stage to add to, by default a new one in memory.
            author: Spawn them now. False leaves that to the caller: ``scene.builder.build_robot()`` and the like.
        """
        cfg = cfg.completed()
        cfg.validate()
        super().__init__(cfg, sim or Simulation(SimulationCfg()), stage or new_stage())
        self.builder, self.controller, self.querier = SceneBuilder(self), SceneController(self), SceneQuerier(self)
        if author:
            self.builder.author()
        self._regenerator = SceneRegenerator(self, self.builder)

    @classmethod
    def from_usd(
        cls,
        stage_or_path: str | Path | Usd.Stage,
        num_envs: int = 1,
        env_spacing: float = 0.0,
        sim_cfg: SimulationCfg | None = None,
    ) -> InteractiveScene:
        """Import a stage as it is, build it, and find its articulations and rigid bodies.

        A stage that :meth:`export` wrote keeps its environments; any other stage is one environment as a whole.
        ``scene.builder.reports`` lists what was read and what was ignored. A warning shows the latter.

        Args:
            stage_or_path: File or open stage.
            num_envs: Number of copies.
            env_spacing: Distance between them [m].
            sim_cfg: Settings; by default those of :class:`SimulationCfg` with the stage's gravity.

        Raises:
            StageError: if the stage cannot be simulated, with the reason.

        A step of the scene's simulation raises ``FloatingPointError`` once its state is not finite.
        """
        stage = open_stage(stage_or_path)
        # gravity=None in the settings takes that of the stage.
        cfg = InteractiveSceneCfg(num_envs=num_envs, env_spacing=env_spacing)
        scene = cls(cfg, Simulation(sim_cfg or SimulationCfg(gravity=None)), stage)
        scene.builder.adopt = True
        if not stage.GetPrimAtPath(ENV_0).IsValid():
            scene.builder.template_root = "/"
        try:
            scene.build()
        except (ValueError, RuntimeError) as error:
            if isinstance(error, (StageError, ConfigError)):
                raise
            # What the solver does not take: it says so by names that it makes of the paths.
            raise StageError(stage_name(stage), *solver_reason(scene.builder.template_labels, error)) from error
        scene.sim.watch_finite()
        scene.builder.reports[0].ignored[:0] = _other_environments(stage, scene.builder.template_root)
        rows = [row for report in scene.builder.reports for row in report.ignored]
        if rows:
            warnings.warn(ignored_text(scene.builder.reports[0].file, rows), stacklevel=2)
        return scene

    # -- construction

    def clone_environments(self, copy_from_source: bool = False) -> None:
        """End the authoring of the environment; the others become copies of it when the scene is built.

        Args:
            copy_from_source: Ignored: no prims are copied either way.
        """
        self.cloned = True  # Newton replicates the model, so there is nothing to copy in the stage

    def filter_collisions(self, global_prim_paths: Sequence[str] | None = None) -> None:
        """Keep environments from colliding with each other, which Newton's worlds never do.

        Args:
            global_prim_paths: Prims that all environments collide with; in Newton those outside the environments.

        Raises:
            ValueError: for a path without a prim.
        """
        for path in global_prim_paths or ():
            if not self.stage.GetPrimAtPath(authored_path(path)).IsValid():
                raise ValueError(f"filter_collisions: no prim at '{path}'; give paths of prims in the scene")

    def build(self) -> None:
        """Make the model: load the stage, replicate the environment, bind the assets."""
        self.builder.build()

    def regenerate(self, seed: int) -> None:
        """Make another scene of the same specification in the same model: graphs stay as they are.

        Heights, terrain origins, patches, obstacles and the stage become those of the seed; levels and types of the
        environments stay. Robots do not move; ``regenerate`` of the environment also begins new episodes.

        Args:
            seed: Seed of the scene.

        Raises:
            ValueError: if no specification made the scene, or something in it cannot change; it is then as it was.
        """
        self._regenerator.regenerate(seed)

    def why_not_regenerable(self) -> str:
        """Reason why :meth:`regenerate` cannot work with any seed, and what to do about it; empty if it can."""
        return self._regenerator.why_not()

    def obstacle_to_regenerating(self) -> str:
        """Former name of :meth:`why_not_regenerable`, which goes with the next release."""
        warnings.warn("use scene.why_not_regenerable()", DeprecationWarning, stacklevel=2)
        return self.why_not_regenerable()

    # -- names and numbers

    @property
    def first_scenery_seed(self) -> int | None:
        """Seed in the config, which made the first scene; None if no specification made it."""
        return self._regenerator.first_seed

    @property
    def scenery_seed(self) -> int | None:
        """Seed that made the present scene; None if no specification made it."""
        return self._regenerator.seed

    @property
    def scenery_paths(self) -> list[Sdf.Path]:
        """Prims below ``/World`` that a specification made, once :meth:`regenerate` was called."""
        return self._regenerator.paths

    @property
    def physics_dt(self) -> float:
        """Time step of the physics [s]."""
        return self.sim.physics_dt

    @property
    def env_prim_paths(self) -> list[str]:
        """Paths of the environments; only the first is authored."""
        return [f"/World/envs/env_{i}" for i in range(self.num_envs)]

    @property
    def env_ns(self) -> str:
        """Prim above the environments."""
        return "/World/envs"

    # -- running

    def reset(self, env_ids: EnvIds = None) -> None:
        """Clear targets, external forces, sensors and the solver's memory in some environments; states stay."""
        self.controller.reset_robots(env_ids, to_default=False)

    def write_data_to_sim(self) -> None:
        """Write what was set on assets since the last step to the simulation."""
        self.controller.apply_actions()

    @property
    def needs_update(self) -> bool:
        """Whether an asset overrides ``update()``."""
        return any(type(a).update is not AssetBase.update for a in self.assets)

    def update(self, dt: float) -> None:
        """Update assets and sensors after ``dt`` seconds of physics."""
        self.update_assets(dt)
        for sensor in self.sensors.values():
            sensor.update(dt)

    def update_assets(self, dt: float) -> None:
        """Update the assets after ``dt`` seconds of physics."""
        for asset in self.assets:
            asset.update(dt)

    def get_state(self, is_relative: bool = False) -> dict[str, dict[str, dict[str, torch.Tensor]]]:
        """States of all assets: ``{"articulation" | "rigid_object": {name: get_robot_state(name)}}``."""
        return self.querier.get_state(is_relative)

    def reset_to(
        self, state: dict[str, dict[str, dict[str, torch.Tensor]]], env_ids: EnvIds = None, is_relative: bool = False
    ) -> None:
        """Bring environments to a state that :meth:`get_state` returned.

        Args:
            state: What :meth:`get_state` returned, one row for each of ``env_ids``.
            env_ids: Environments, default all.
            is_relative: Whether positions are relative to the environments' origins.
        """
        self.reset(env_ids)  # targets, external forces and the solver's memory belong to the state that is left
        for family in state.values():
            for name, values in family.items():
                asset = self[name]
                rows = asset.env_indices(env_ids)
                pose = values["root_pose"].clone()
                if is_relative:
                    pose[:, :3] += self.env_origins[rows]
                asset.write_native_root_state(pose, values["root_velocity"], rows)
                if "joint_position" in values:
                    asset.write_joint_state_to_sim(values["joint_position"], values["joint_velocity"], env_ids=rows)
        self.sim.forward(self.controller.mask(env_ids))

    def export(self, path: str | Path) -> None:
        """Write the scene as one self-contained USD file, the drives of its actuators included.

        :meth:`from_usd` opens it again with the same model. It is in metres and kilograms, with the up axis of the
        scene's stage. A URDF or MJCF asset stays a reference to its file.

        Raises:
            RuntimeError: if the scene is not built.
            ValueError: an explicit actuator that USD has no way to express.
        """
        export_stage(self, Path(path), self.builder.authored_joints, self.builder.reports)

    def close(self) -> None:
        """Release the simulation."""
        self.sim.close()


def _other_environments(stage: Usd.Stage, template_root: str) -> Ignored:
    """A row for environments that a stage has beside the one whose copies the scene has."""
    if template_root != ENV_0:
        return []
    others = [str(p.GetPath()) for p in stage.GetPrimAtPath(ENV_0).GetParent().GetChildren() if p.GetPath() != ENV_0]
    if not others:
        return []
    where = others[0] + (f" (+{len(others) - 1} more)" if len(others) > 1 else "")
    return [(where, "environment", f"left out: every environment is a copy of {ENV_0}; num_envs sets their number")]
