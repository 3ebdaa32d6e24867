# SPDX-License-Identifier: Apache-2.0
"""What is in a scene; the scene's faces work on it without knowing the scene itself."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any

import torch
from pxr import Usd

from stripe_newton.assets import Articulation, AssetBase, RigidObject
from stripe_newton.sim import Simulation
from stripe_newton.sim.stage import scene_context

from .grid import spiral_grid
from .interactive_scene_cfg import InteractiveSceneCfg

__all__ = ["SceneContents"]


class SceneContents:
    """Stage, simulation and assets.

    Attributes:
        cfg: The config.
        stage: The USD stage.
        sim: The simulation.
        device: ``"cpu"`` or ``"cuda:N"``.
        assets: Every asset in order of construction.
        articulations: Articulations by name.
        rigid_objects: Rigid bodies by name.
        sensors: Sensors by name.
        extras: Static assets by name.
        terrain: What the environments stand on, if the scene names it.
        env_origins: Origins of the environments in the world frame [m], shape ``(num_envs, 3)``.
        cloned: Whether the environment is complete.
        built: Whether the model is made.
    """

    def __init__(self, cfg: InteractiveSceneCfg, sim: Simulation, stage: Usd.Stage):
        self.cfg, self.sim, self.stage = cfg, sim, stage
        self.device = sim.device
        self.assets: list[AssetBase] = []
        self.articulations: dict[str, Articulation] = {}
        self.rigid_objects: dict[str, RigidObject] = {}
        self.sensors: dict[str, Any] = {}
        self.extras: dict[str, Any] = {}
        self.terrain: Any = None
        self.env_origins = torch.from_numpy(spiral_grid(cfg.num_envs, cfg.env_spacing)).to(self.device)
        self.cloned = self.built = False

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return self.cfg.num_envs

    def keys(self) -> list[str]:
        """Names of everything in the scene."""
        terrain = ["terrain"] if self.terrain is not None else []
        return [*terrain, *self.articulations, *self.rigid_objects, *self.sensors, *self.extras]

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def __getitem__(self, key: str) -> Any:
        if key == "terrain" and self.terrain is not None:
            return self.terrain
        for family in (self.articulations, self.rigid_objects, self.sensors, self.extras):
            if key in family:
                return family[key]
        raise KeyError(f"no '{key}' in the scene; it has {', '.join(self.keys()) or 'nothing'}")

    def construction(self) -> AbstractContextManager[None]:
        """Inside this context spawners and assets add to this scene."""
        return scene_context(self)

    def register(self, asset: AssetBase) -> None:
        """Take note of an asset that was just spawned.

        Raises:
            RuntimeError: if the model is built already, or the environments were cloned.
        """
        if self.built or (self.cloned and asset.in_every_env):
            when = "the scene is built" if self.built else "'clone_environments' was called"
            raise RuntimeError(f"'{asset.cfg.prim_path}' comes after {when}: create it before")
        if asset.path in {a.path for a in self.assets}:
            raise ValueError(f"two assets at '{asset.cfg.prim_path}': give each its own prim_path")
        self.assets.append(asset)
