# SPDX-License-Identifier: Apache-2.0
"""Scene specification: terrain, palette of assets and lights in plain Python, from which a seed makes a scene."""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Usd

from stripe_newton.sim import DistantLightCfg, DomeLightCfg

from .asset_instance import AssetInstance
from .asset_spec import AssetSpec
from .authoring import author_scene
from .places import Places, add_places
from .primitive_meshes import DebugMesh
from .scene_cfg_factory import SceneCfgFactory
from .terrain_instance import TerrainInstance

__all__ = ["Scene", "SceneSpec"]

Progress = Callable[[str], None]
"""Called with the name of each part before it is made."""


class SceneSpec(ABC):
    """A terrain, a palette of assets and lights. Subclass it and fill :meth:`generate`.

    Args:
        size: Extent in x and y [m].
        palette: Specifications of the assets, in the order in which they are placed.
        distant_light: The sun. None: no sun.
        dome_light: The sky. None: no sky.
        places: Places to find for robots, by name: ``init_pos`` to start, ``target`` to go to.

    Raises:
        ValueError: if two specs have one name.
    """

    def __init__(
        self,
        size: tuple[float, float],
        palette: Iterable[AssetSpec] = (),
        distant_light: DistantLightCfg | None = None,
        dome_light: DomeLightCfg | None = None,
        places: Mapping[str, Places] | None = None,
    ):
        if min(size) <= 0.0 or not np.isfinite(size).all():
            raise ValueError(f"{type(self).__name__}: size is {size}, must be two positive lengths [m]")
        self.size = float(size[0]), float(size[1])
        self.distant_light, self.dome_light = distant_light, dome_light
        self.places = dict(places or {})
        self._palette: dict[str, AssetSpec] = {}
        for asset in palette:
            self.add_asset(asset)

    def __deepcopy__(self, memo: dict[int, object]) -> SceneSpec:
        return self  # copies of a config share its spec: the caches of made scenes know it by identity

    @property
    def palette(self) -> dict[str, AssetSpec]:
        """A copy of the asset specifications by name, in the order in which they are placed."""
        return dict(self._palette)

    def add_asset(self, asset: AssetSpec) -> None:
        """Add an asset specification to the palette.

        Raises:
            ValueError: if the scene has one of that name.
        """
        if asset.name in self._palette:
            raise ValueError(
                f"{type(self).__name__}: has an asset spec '{asset.name}' already, "
                f"a {type(self._palette[asset.name]).__name__}; give the new one another name"
            )
        self._palette[asset.name] = asset

    @abstractmethod
    def generate(self, rng: np.random.Generator) -> TerrainInstance:
        """Generate the terrain.

        Args:
            rng: The only source of random numbers; equal generators give equal terrains.
        """

    def survey(self, terrain: TerrainInstance) -> None:
        """Add maps of the finished scene to ``terrain.maps``. By default there are none."""
        return

    def create_instance(
        self, num_envs: int, env_spacing: float, debug_models: bool = False, seed: int = 0
    ) -> SceneCfgFactory:
        """A factory of scene configs for simulation. The scene itself is made when it is simulated."""
        return SceneCfgFactory(self, num_envs, env_spacing, seed, debug_models)

    def create(self, seed: int = 0, debug_models: bool = False, progress: Progress | None = None) -> Scene:
        """Make a scene: the terrain, then the assets of each specification.

        Each specification draws from its own generator, which depends on the seed and the specification's name. So
        another specification at the end of the palette does not change those before it.

        Args:
            seed: Whole number, 0 or more. The same seed gives the same scene.
            debug_models: Keep instances of :class:`DebugMesh`.
            progress: Called with the name of each part before it is made.

        Raises:
            ValueError: if two instances of a specification have one name, or the terrain has another size.
        """
        if seed < 0:
            raise ValueError(f"{type(self).__name__}: seed is {seed}, must be 0 or more")
        say = progress or (lambda text: None)
        say("terrain")
        terrain = self.generate(_generator(seed, "terrain"))
        # Whole cells seldom fill the size exactly, hence the tolerance.
        if not np.allclose(terrain.size, self.size, rtol=1.0e-3):
            raise ValueError(
                f"{type(self).__name__}.generate: the terrain is {terrain.size[0]:g} by {terrain.size[1]:g} m, "
                f"must be {self.size[0]:g} by {self.size[1]:g} m"
            )
        # A terrain may be kept and returned again by its specification.
        terrain.placed.clear()
        for name, asset in self._palette.items():
            say(name)
            instances = list(asset.generate(terrain, _generator(seed, name)))
            terrain.placed[name] = [i for i in instances if debug_models or not isinstance(i.mesh, DebugMesh)]
            _check_names(name, terrain.placed[name])
        if self.places:  # after the assets, which they must be clear of
            say("places")
            add_places(terrain, self.places, _generator(seed, "places"))
        # Last, so that maps may depend on everything.
        say("survey")
        self.survey(terrain)
        return Scene(terrain, self.distant_light, self.dome_light, seed)


@dataclass(eq=False)
class Scene:
    """A generated scene.

    Attributes:
        terrain: The ground, with all assets in ``terrain.placed``.
        distant_light: The sun.
        dome_light: The sky.
        seed: Seed that it was made from.
    """

    terrain: TerrainInstance
    distant_light: DistantLightCfg | None = None
    dome_light: DomeLightCfg | None = None
    seed: int = 0
    _stage: Usd.Stage | None = field(default=None, repr=False)

    @property
    def instances(self) -> list[AssetInstance]:
        """All assets, in the order in which they were placed."""
        return [i for placed in self.terrain.placed.values() for i in placed]

    @property
    def stage(self) -> Usd.Stage:
        """The scene in USD, authored at the first access."""
        if self._stage is None:
            self._stage = author_scene(self.terrain, self.dome_light, self.distant_light)
        return self._stage

    def export(self, path: str | Path) -> Path:
        """Write the stage to a file: ``.usda``, ``.usdc`` or ``.usd``.

        Raises:
            ValueError: for another kind of file.
        """
        file = Path(path).expanduser()
        if file.suffix not in (".usd", ".usda", ".usdc"):
            raise ValueError(f"'{path}': must end in .usd, .usda or .usdc")
        file.parent.mkdir(parents=True, exist_ok=True)
        self.stage.GetRootLayer().Export(str(file))
        return file


def _check_names(spec: str, instances: list[AssetInstance]) -> None:
    counts = Counter(i.name for i in instances)
    if len(counts) < len(instances):
        twice = counts.most_common(1)[0][0]
        raise ValueError(f"asset '{spec}': two instances are called '{twice}'; names must differ")


def _generator(seed: int, name: str) -> np.random.Generator:
    # crc32 and not hash(): Python's hash of a string differs from process to process.
    return np.random.default_rng([seed, zlib.crc32(name.encode())])
