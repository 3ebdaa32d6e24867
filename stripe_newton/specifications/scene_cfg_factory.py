# SPDX-License-Identifier: Apache-2.0
"""From a scene that a spec makes to the config of a simulated scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pxr import Sdf

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.configclass import configclass
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.stage import current_stage

from .scene_spec import Scene, SceneSpec

if TYPE_CHECKING:
    from pxr import Usd

__all__ = ["SceneCfgFactory", "SceneStageCfg"]


def spawn_scene_stage(prim_path: str, cfg: SceneStageCfg, *pose: Any) -> Usd.Prim:
    """Copy the stage of a scene: everything below ``/World``, and its prototypes.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that :meth:`Scene.export` did not write, or if something of the scene has the path of
            something that is there.
    """
    stage = current_stage()
    source, target = _layer(cfg), stage.GetRootLayer()
    world = source.GetPrimAtPath("/World")
    if not world or not source.GetPrimAtPath("/Prototypes"):
        raise ValueError(
            f"'{cfg.usd_path}': is no scene of a spec, it has no /World and /Prototypes; spawn it by UsdFileCfg"
        )
    with Sdf.ChangeBlock():
        Sdf.CreatePrimInLayer(target, "/World")
        for child in world.nameChildren:
            if target.GetPrimAtPath(child.path):
                raise ValueError(f"'{child.path}': the stage has it already, and the scene's spec makes it too")
            Sdf.CopySpec(source, child.path, target, child.path)
        Sdf.CopySpec(source, Sdf.Path("/Prototypes"), target, Sdf.Path("/Prototypes"))
    return stage.GetPrimAtPath(prim_path)


def _layer(cfg: SceneStageCfg) -> Sdf.Layer:
    if cfg.usd_path is None:
        return cfg.made().stage.GetRootLayer()
    file = Path(cfg.usd_path).expanduser()
    if not file.is_file():
        raise FileNotFoundError(f"scene '{cfg.usd_path}': no such file; give the path of an exported scene")
    return Sdf.Layer.FindOrOpen(str(file))


@lru_cache(maxsize=4)
def _made(spec: SceneSpec, seed: int, debug_models: bool) -> Scene:
    return spec.create(seed, debug_models)


@configclass
class SceneStageCfg(SpawnerCfg):
    """Spawns what a spec makes: terrain, assets, lights."""

    func: Callable[..., Any] = spawn_scene_stage
    """Function that authors it."""
    spec: Any = None
    """The :class:`SceneSpec`."""
    seed: int = 0
    """Seed of the scene."""
    debug_models: bool = False
    """Whether markers are part of it."""
    usd_path: str | None = None
    """A file that :meth:`Scene.export` wrote, in place of ``spec``."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if (self.spec is None) == (self.usd_path is None):
            yield "spec", "give either a SceneSpec or the usd_path of an exported scene"

    def made(self) -> Scene:
        """The scene of ``spec`` and ``seed``; the last few are kept."""
        return _made(self.spec, self.seed, self.debug_models)


class SceneCfgFactory:
    """Makes the config of a simulated scene: what a spec makes, a robot, and whatever is added.

    Args:
        scene: The spec, or the path of a file that a scene was exported to.
        num_envs: Number of environments; all share the terrain and what stands on it.
        env_spacing: Distance between their origins [m].
        seed: Seed of the scene.
        debug_models: Whether markers are part of it.
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
        self._fields: dict[str, Any] = {}

    def add_asset(self, name: str, cfg: Any) -> None:
        """Add an asset of each environment, or a shared one outside of them.

        Raises:
            ValueError: if the name is taken.
        """
        if name in self._fields or name in ("scenery", "robot"):
            raise ValueError(f"scene: has '{name}' already; give '{type(cfg).__name__}' another name")
        if not name.isidentifier():
            raise ValueError(f"scene: '{name}' must be an identifier: letters, digits and '_'")
        self._fields[name] = cfg

    def add_sensor(self, name: str, cfg: Any) -> None:
        """Add a sensor; see :meth:`add_asset`."""
        self.add_asset(name, cfg)

    def get_scene(self, robot: ArticulationCfg) -> InteractiveSceneCfg:
        """The config, with a field for everything; the scene is ``scenery``.

        Args:
            robot: Its ``prim_path`` is set to ``{ENV_REGEX_NS}/Robot``.
        """
        scenery = AssetBaseCfg(prim_path="/World/ground", spawn=self.spawn)
        fields = {"scenery": scenery, "robot": robot.replace(prim_path="{ENV_REGEX_NS}/Robot"), **self._fields}
        body = {"__annotations__": dict.fromkeys(fields, Any), "__module__": __name__, **dict.fromkeys(fields)}
        made: Any = configclass(type("SpecSceneCfg", (InteractiveSceneCfg,), body))
        cfg: InteractiveSceneCfg = made(num_envs=self.num_envs, env_spacing=self.env_spacing)
        for name, value in fields.items():
            setattr(cfg, name, value)
        return cfg
