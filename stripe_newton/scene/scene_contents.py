# SPDX-License-Identifier: Apache-2.0
"""Scene contents: the stage, simulation, assets and sensors of a scene, and the config that says how many there are.

Builder, controller and querier of a scene work on its contents, without knowing the scene itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from pxr import Usd

from stripe_newton.assets import (
    Articulation,
    AssetBase,
    AssetBaseCfg,
    RigidObject,
    RigidObjectCollection,
    TerrainBase,
)
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.sensors import SensorBase
from stripe_newton.sim import Simulation
from stripe_newton.sim.scene_context import scene_context
from stripe_newton.terrains.spiral_grid import spiral_grid
from stripe_newton.usd.file_errors import path_reason
from stripe_newton.value_types import NonNegativeFloat, PositiveInt, short

from .scene_parts import Part, configured_parts, with_prim_paths
from .scenery_options import SceneryOptionsCfg

if TYPE_CHECKING:
    from .imported_scenery import ImportedScenery

__all__ = ["InteractiveSceneCfg", "SceneContents"]


_GREATEST_EXTENT = 1.0e5
"""Side of the square of all environments, at whose edge float32 has steps of 8 mm [m]."""


@configclass
class InteractiveSceneCfg:
    """Number of environments, and what is in each.

    Subclass it and add assets as fields, in the order they are to be spawned::

        @configclass
        class SceneCfg(InteractiveSceneCfg):
            ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
            robot: ArticulationCfg = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    """

    num_envs: PositiveInt = MISSING
    """Number of environments."""
    env_spacing: NonNegativeFloat = MISSING
    """Distance between neighbouring environments [m]. With 0 all stand at the origin, where float32 is finest. Without
    effect in a scenery, where environments share one world."""
    scenery: str | AssetBaseCfg | None = None
    """File of a world that somebody else wrote, as the scenery of all environments: USD, such as ``room.usd``, or MJCF,
    of which what stands still is read. In scenes of a specification, the asset that is made of it."""
    scenery_options: SceneryOptionsCfg = SceneryOptionsCfg()
    """Pose and size of the scenery, what becomes of the task's ground, and where robots start."""
    lazy_sensor_update: bool = True
    """Ignored: sensors measure as part of the step, in their ``update_period``."""
    replicate_physics: bool = True
    """Without effect: environments differ in the rigid objects of ``MultiAssetSpawnerCfg`` and ``MultiUsdFileCfg``, and
    are copies of one otherwise."""
    filter_collisions: bool = True
    """Ignored: environments never collide with each other."""
    clone_in_fabric: bool = False
    """Ignored: prims are never copied."""

    def parts(self) -> list[tuple[str, Part]]:
        """Names and configs of assets and sensors, in order. The items of a dict go by their keys."""
        return list(configured_parts(self, InteractiveSceneCfg.__dataclass_fields__))

    def completed(self) -> InteractiveSceneCfg:
        """The config with a prim path for each part that has none: ``{ENV_REGEX_NS}/NAME``, in camel case."""
        return with_prim_paths(self, InteractiveSceneCfg.__dataclass_fields__)

    @property
    def scenery_file(self) -> str | None:
        """The file that ``scenery`` names. An asset or sensor of a subclass may have that name, and is none."""
        return self.scenery if isinstance(self.scenery, str) else None

    IGNORED: ClassVar[dict[str, str]] = {
        "lazy_sensor_update": "sensors measure as part of the step, in their update_period",
        "filter_collisions": "environments never collide with each other",
        "clone_in_fabric": "prims are never copied",
    }

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.num_envs is not MISSING and self.env_spacing is not MISSING:
            extent = self.env_spacing * math.sqrt(self.num_envs)
            if extent > _GREATEST_EXTENT:
                text = f"is {self.env_spacing}, which with num_envs={self.num_envs} takes a square of {extent:.3g} m"
                yield "env_spacing", f"{text}; float32 is too coarse there, at most {_GREATEST_EXTENT:g} m can be"
        if self.scenery_file is not None and (reason := path_reason(Path(self.scenery_file).expanduser())):
            yield "scenery", f"'{self.scenery_file}': {reason}"


class SceneContents:
    """Stage, simulation, assets and sensors of a scene."""

    cfg: InteractiveSceneCfg
    """The config."""
    stage: Usd.Stage
    """The USD stage."""
    sim: Simulation
    """The simulation."""
    device: str
    """``"cpu"`` or ``"cuda:N"``."""
    assets: list[AssetBase]
    """Every asset in order of construction."""
    articulations: dict[str, Articulation]
    """Articulations by name."""
    rigid_objects: dict[str, RigidObject]
    """Rigid bodies by name."""
    rigid_object_collections: dict[str, RigidObjectCollection]
    """Collections of rigid bodies by name. Those of the config have their bodies in :attr:`rigid_objects`, too."""
    sensors: dict[str, SensorBase]
    """Sensors by name."""
    extras: dict[str, AssetBase]
    """Static assets by name."""
    terrain: TerrainBase | None
    """Ground of the environments, if the scene names it."""
    scenery: ImportedScenery | None
    """World that the config's ``scenery`` names, once the scene is built."""
    env_origins: torch.Tensor
    """Origins of the environments in the world frame [m], shape ``(num_envs, 3)``."""
    cloned: bool
    """Whether the environment is complete."""
    built: bool
    """Whether the model is made."""

    def __init__(self, cfg: InteractiveSceneCfg, sim: Simulation, stage: Usd.Stage):
        self.cfg, self.sim, self.stage = cfg, sim, stage
        self.device = sim.device
        self.assets, self.articulations, self.rigid_objects = [], {}, {}
        self.rigid_object_collections, self.sensors, self.extras = {}, {}, {}
        self.terrain, self.scenery = None, None
        # One tensor for life: a terrain writes into it, and kernels read its memory.
        self.env_origins = torch.from_numpy(spiral_grid(cfg.num_envs, cfg.env_spacing)).to(self.device)
        self.cloned = self.built = False

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return self.cfg.num_envs

    def keys(self) -> list[str]:
        """Names of everything in the scene."""
        terrain = ["terrain"] if self.terrain is not None else []
        bodies = [*self.articulations, *self.rigid_objects, *self.rigid_object_collections]
        return [*terrain, *bodies, *self.sensors, *self.extras]

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def __getitem__(self, key: str) -> Any:  # of whichever class the config of that name makes
        if not isinstance(key, str):
            raise KeyError(f"the scene has names, such as 'robot', not {short(key)}; it has {', '.join(self.keys())}")
        if key == "terrain" and self.terrain is not None:
            return self.terrain
        bodies = self.articulations, self.rigid_objects, self.rigid_object_collections
        for family in (*bodies, self.sensors, self.extras):
            if key in family:
                return family[key]
        raise KeyError(f"no '{key}' in the scene; it has {', '.join(self.keys()) or 'nothing'}")

    def alias(self, path: str) -> str:
        """Another spelling of a prim path, for scenes that name their environments otherwise; by default itself."""
        return path

    def construction(self) -> AbstractContextManager[None]:
        """Inside this context spawners and assets add to this scene."""
        return scene_context(self)

    def register(self, asset: AssetBase) -> None:
        """Add an asset that was just spawned.

        Raises:
            RuntimeError: if the model is built already, or the environments were cloned.
            ValueError: if there is an asset at its path already.
        """
        if self.built or (self.cloned and asset.in_every_env):
            when = "the scene is built" if self.built else "'clone_environments' was called"
            raise RuntimeError(f"'{asset.cfg.prim_path}' comes after {when}: create it before")
        if asset.path in {a.path for a in self.assets}:
            raise ValueError(f"two assets at '{asset.cfg.prim_path}': give each its own prim_path")
        self.assets.append(asset)
