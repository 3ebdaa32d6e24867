# SPDX-License-Identifier: Apache-2.0
"""Scene config factory: the config of a simulated scene from a scene specification, a robot and sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from pxr import Sdf, Usd

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.configclass import config_with, configclass
from stripe_newton.input_files import why_no_file
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import SceneSpawnerCfg
from stripe_newton.sim.scene_context import current_stage

if TYPE_CHECKING:
    from .scene_spec import Scene, SceneSpec

__all__ = ["SceneCfgFactory", "SceneEntryCfg", "SceneStageCfg"]


class SceneEntryCfg(Protocol):
    """Config of anything that a scene consists of: an asset, a sensor or obstacles."""

    @property
    def prim_path(self) -> str: ...

    @property
    def class_type(self) -> Callable[..., object] | None: ...


def spawn_scene_stage(prim_path: str, cfg: SceneStageCfg, *pose: object) -> Usd.Prim:
    """Copy the stage of a scene: everything below ``/World``, and its prototypes.

    Args:
        prim_path: Path of the prim to return.
        cfg: The specification or file.
        pose: Ignored: a scene stays where its specification puts it.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that :meth:`Scene.export` did not write, or if a path of the scene exists already.
    """
    stage = current_stage()
    source, target = _layer(cfg), stage.GetRootLayer()
    world = source.GetPrimAtPath("/World")
    if not world or not source.GetPrimAtPath("/Prototypes"):
        raise ValueError(
            f"'{cfg.usd_path}': is no scene of a spec, it has no /World and /Prototypes; spawn it by UsdFileCfg"
        )
    # Copied in the layer, in one block: the stage composes once, not at each of thousands of prims.
    with Sdf.ChangeBlock():
        Sdf.CreatePrimInLayer(target, "/World")
        for child in world.nameChildren:
            # CopySpec would replace what is there.
            if target.GetPrimAtPath(child.path):
                raise ValueError(f"'{child.path}': the stage has it already, and the scene's spec makes it too")
            Sdf.CopySpec(source, child.path, target, child.path)
        Sdf.CopySpec(source, Sdf.Path("/Prototypes"), target, Sdf.Path("/Prototypes"))
    return stage.GetPrimAtPath(prim_path)


def _layer(cfg: SceneStageCfg) -> Sdf.Layer:
    """The root layer of the scene that a config names."""
    if cfg.usd_path is None:
        return cfg.made().stage.GetRootLayer()
    file = Path(cfg.usd_path).expanduser()
    if problem := why_no_file(file):
        raise FileNotFoundError(f"scene '{cfg.usd_path}': {problem}; give the path of an exported scene")
    # An open layer is shared: several environments of one file read it once.
    return Sdf.Layer.FindOrOpen(str(file))


# A scene is asked for several times while a simulation is built, and making a forest takes tens of seconds.
@lru_cache(maxsize=4)
def _made(spec: SceneSpec, seed: int, debug_models: bool) -> Scene:
    return spec.create(seed, debug_models)


@configclass
class SceneStageCfg(SceneSpawnerCfg):
    """Spawns what a spec makes: terrain, assets, lights."""

    func: Callable[..., Usd.Prim] = spawn_scene_stage
    """Function that authors it."""
    spec: SceneSpec | None = None
    """The scene specification."""
    seed: int = 0
    """Seed of the scene."""
    debug_models: bool = False
    """Whether the scene contains markers."""
    usd_path: str | None = None
    """A file that :meth:`Scene.export` wrote, instead of ``spec``."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if (self.spec is None) == (self.usd_path is None):
            yield "spec", "give either a SceneSpec or the usd_path of an exported scene"

    def made(self) -> Scene:
        """The scene of ``spec`` and ``seed``. The last few scenes are kept."""
        if self.spec is None:
            raise ValueError(f"the scene is of the file '{self.usd_path}', not of a specification")
        return _made(self.spec, self.seed, self.debug_models)

    def made_stage(self) -> Usd.Stage:
        return self.made().stage

    def why_not_regenerable(self) -> str:
        if self.spec is not None:
            return ""
        return f"the scene is of the file '{self.usd_path}', of which there is no other; give its specification"


class SceneCfgFactory:
    """Makes the config of a simulated scene: a generated scene, a robot, and further assets and sensors.

    Args:
        scene: The scene specification, or the path of a file that a scene was exported to.
        num_envs: Number of environments. All share the terrain and the assets on it.
        env_spacing: Distance between their origins [m].
        seed: Seed of the scene.
        debug_models: Whether the scene contains markers.
    """

    def __init__(
        self,
        scene: SceneSpec | str | Path,
        num_envs: int,
        env_spacing: float,
        seed: int = 0,
        debug_models: bool = False,
    ):
        self.num_envs, self.env_spacing = num_envs, env_spacing
        self.spawn = SceneStageCfg(usd_path=str(scene)) if isinstance(scene, (str, Path)) else SceneStageCfg(spec=scene)
        self.spawn.seed, self.spawn.debug_models = seed, debug_models
        self._fields: dict[str, SceneEntryCfg] = {}

    def add_asset(self, name: str, cfg: SceneEntryCfg) -> None:
        """Add an asset: one in each environment, or a shared one outside of them.

        Raises:
            ValueError: if the name is taken.
        """
        if name in self._fields or name in ("scenery", "robot"):
            raise ValueError(f"scene: has '{name}' already; give '{type(cfg).__name__}' another name")
        if not name.isidentifier():
            raise ValueError(f"scene: '{name}' must be an identifier: letters, digits and '_'")
        self._fields[name] = cfg

    def add_sensor(self, name: str, cfg: SceneEntryCfg) -> None:
        """Add a sensor; see :meth:`add_asset`."""
        self.add_asset(name, cfg)

    def get_scene(self, robot: ArticulationCfg | None = None) -> InteractiveSceneCfg:
        """The config, with a field for each asset and sensor. The generated scene is the field ``scenery``.

        Args:
            robot: The robot, with the field ``robot``; its ``prim_path`` is set to ``{ENV_REGEX_NS}/Robot``. None for a
                scene without one.
        """
        # The terrain is found at this path once the stage is authored: see found_terrain().
        scenery = AssetBaseCfg(prim_path="/World/ground", spawn=self.spawn)
        robots = {} if robot is None else {"robot": robot.replace(prim_path="{ENV_REGEX_NS}/Robot")}
        fields = {"scenery": scenery, **robots, **self._fields}
        cfg = InteractiveSceneCfg(num_envs=self.num_envs, env_spacing=self.env_spacing)
        return config_with(cfg, fields)
