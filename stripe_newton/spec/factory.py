# SPDX-License-Identifier: Apache-2.0
"""From a scene that a spec made to the config of a simulated scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pxr import Sdf

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.stage import current_stage

from .scene import Scene

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
    source, target = _layer(cfg.scene), stage.GetRootLayer()
    world = source.GetPrimAtPath("/World")
    if not world or not source.GetPrimAtPath("/Prototypes"):
        raise ValueError(
            f"'{cfg.scene}': is no scene of a spec, it has no /World and /Prototypes; spawn it by UsdFileCfg"
        )
    with Sdf.ChangeBlock():
        Sdf.CreatePrimInLayer(target, "/World")
        for child in world.nameChildren:
            if target.GetPrimAtPath(child.path):
                raise ValueError(f"'{child.path}': the stage has it already, and the scene's spec makes it too")
            Sdf.CopySpec(source, child.path, target, child.path)
        Sdf.CopySpec(source, Sdf.Path("/Prototypes"), target, Sdf.Path("/Prototypes"))
    return stage.GetPrimAtPath(prim_path)


def _layer(scene: Scene | str | Path) -> Sdf.Layer:
    if isinstance(scene, Scene):
        return scene.stage.GetRootLayer()
    file = Path(scene).expanduser()
    if not file.is_file():
        raise FileNotFoundError(f"scene '{scene}': no such file; give the path of an exported scene")
    return Sdf.Layer.FindOrOpen(str(file))


@configclass
class SceneStageCfg(SpawnerCfg):
    """Spawns what a spec made: terrain, assets, lights."""

    func: Callable[..., Any] = spawn_scene_stage
    """Function that authors it."""
    scene: Any = MISSING
    """The :class:`Scene`, or the path of the file it was exported to."""


class SceneCfgFactory:
    """Makes the config of a simulated scene: what a spec made, a robot, and whatever is added.

    Args:
        scene: What the spec made, or the path of the file that it was exported to.
        num_envs: Number of environments; all share the terrain and what stands on it.
        env_spacing: Distance between their origins [m].
    """

    def __init__(self, scene: Scene | str | Path, num_envs: int, env_spacing: float):
        self.scene, self.num_envs, self.env_spacing = scene, num_envs, env_spacing
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
        """The config, with a field for everything.

        Args:
            robot: Its ``prim_path`` is set to ``{ENV_REGEX_NS}/Robot``.
        """
        scenery = AssetBaseCfg(prim_path="/World/ground", spawn=SceneStageCfg(scene=self.scene))
        fields = {"scenery": scenery, "robot": robot.replace(prim_path="{ENV_REGEX_NS}/Robot"), **self._fields}
        body = {"__annotations__": dict.fromkeys(fields, Any), "__module__": __name__, **dict.fromkeys(fields)}
        made: Any = configclass(type("SpecSceneCfg", (InteractiveSceneCfg,), body))
        cfg = made(num_envs=self.num_envs, env_spacing=self.env_spacing)
        for name, value in fields.items():
            setattr(cfg, name, value)
        found: InteractiveSceneCfg = cfg
        return found
