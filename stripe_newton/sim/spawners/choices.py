# SPDX-License-Identifier: Apache-2.0
"""Spawners of which each environment gets another asset: one of a list of spawners, or of a list of USD files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
from pxr import Usd

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import Seed

from .from_files import UsdFileCfg
from .spawner_cfg import Orientation, RigidObjectSpawnerCfg, SpawnerCfg, Translation

__all__ = ["AssetChoiceCfg", "MultiAssetSpawnerCfg", "MultiUsdFileCfg", "spawn_multi_asset", "spawn_multi_usd_file"]

_MERGED = "mass_props", "rigid_props", "collision_props"
"""Fields that override those of each asset."""


@configclass
class AssetChoiceCfg(SpawnerCfg):
    """Base of the configs of which each environment gets another asset."""

    random_choice: bool = True
    """Draw the asset of each environment; otherwise they take turns."""
    seed: Seed = 0
    """Seed of the draw."""

    def assets(self) -> list[SpawnerCfg]:
        """The spawners of the assets."""
        raise NotImplementedError

    def choices(self, num_envs: int) -> np.ndarray:
        """Which asset each environment gets, shape ``(num_envs,)``.

        What an environment gets does not depend on how many others there are.
        """
        count = len(self.assets())
        if not self.random_choice:
            return np.arange(num_envs) % count
        return (np.random.default_rng(self.seed).random(num_envs) * count).astype(int)

    def spawn_first(self, prim_path: str, translation: Translation, orientation: Orientation) -> Usd.Prim:
        """Author the asset of the first environment, whose prims the stage holds."""
        return self.assets()[self.choices(1)[0]].spawn(prim_path, translation, orientation)


def spawn_multi_asset(
    prim_path: str, cfg: MultiAssetSpawnerCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author the asset of the first environment; the scene builds the others when it makes the model."""
    return cfg.spawn_first(prim_path, translation, orientation)


def spawn_multi_usd_file(
    prim_path: str, cfg: MultiUsdFileCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Reference the file of the first environment; the scene builds the others when it makes the model."""
    return cfg.spawn_first(prim_path, translation, orientation)


@configclass
class MultiAssetSpawnerCfg(AssetChoiceCfg, RigidObjectSpawnerCfg):
    """Assets of which each environment gets one: the ``spawn`` of a ``RigidObjectCfg``.

    All environments step in one graph. Properties that are set here override those of each asset.
    """

    func: Callable[..., Usd.Prim] = spawn_multi_asset
    """Function that authors the asset of the first environment."""
    assets_cfg: list[SpawnerCfg] = MISSING
    """The assets. Each makes one rigid body, of any shapes."""
    visible: bool = True
    """Ignored: it is that of the assets."""

    IGNORED: ClassVar[dict[str, str]] = {"visible": "it is that of the assets"}

    def assets(self) -> list[SpawnerCfg]:
        return [self._merged(asset) for asset in self.assets_cfg]

    def _merged(self, asset: SpawnerCfg) -> SpawnerCfg:
        merged: Any = asset.copy()
        for name in _MERGED:
            if getattr(self, name) is not None and hasattr(merged, name):
                setattr(merged, name, getattr(self, name))
        merged.semantic_tags = [*(asset.semantic_tags or []), *(self.semantic_tags or [])] or None
        return merged

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.assets_cfg is not MISSING:
            yield from _none(self.assets_cfg, "assets_cfg", "asset")


@configclass
class MultiUsdFileCfg(AssetChoiceCfg, UsdFileCfg):
    """USD files of which each environment gets one: the ``spawn`` of a ``RigidObjectCfg``, as
    :class:`MultiAssetSpawnerCfg`. The other fields hold for each file."""

    func: Callable[..., Usd.Prim] = spawn_multi_usd_file
    """Function that references the file of the first environment."""
    usd_path: str | list[str] = MISSING  # type: ignore[assignment]  # a list in Isaac Lab, too
    """The files."""

    FILE_CFG: ClassVar[type[UsdFileCfg]] = UsdFileCfg
    """Class of the spawner of a file."""

    def assets(self) -> list[SpawnerCfg]:
        return list(self._files())

    def _files(self) -> list[UsdFileCfg]:
        names = set(self.FILE_CFG.__dataclass_fields__) - {"func", "usd_path"}
        fields = {name: getattr(self, name) for name in names}
        paths = [self.usd_path] if isinstance(self.usd_path, str) else self.usd_path
        return [self.FILE_CFG(usd_path=path, **fields) for path in paths]

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.usd_path is MISSING:
            return
        yield from _none(self.usd_path, "usd_path", "file")
        for index, asset in enumerate(self._files()):
            for name, problem in asset.problems():
                yield (f"usd_path[{index}]" if name == "usd_path" else name), problem


def _none(values: Sequence[object], field: str, what: str) -> Iterator[tuple[str, str]]:
    if not len(values):
        yield field, f"is empty, must have one {what} or more"
