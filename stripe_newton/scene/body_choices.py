# SPDX-License-Identifier: Apache-2.0
"""Body choices of a scene: its rigid objects of which each environment holds another asset."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import newton

from stripe_newton.assets import AssetBase, RigidObject
from stripe_newton.configclass import ConfigError
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.body_choice import BodyChoice, why_no_choice
from stripe_newton.sim.spawners.choices import AssetChoiceCfg

__all__ = ["body_choices"]

Load = Callable[[SpawnerCfg, AssetBase], newton.ModelBuilder]
"""Makes the builder of an asset that is spawned in the place of another."""


def body_choices(
    assets: Sequence[AssetBase], num_envs: int, template: newton.ModelBuilder, load: Load
) -> list[BodyChoice]:
    """Give the template the shapes of all assets that an environment may hold.

    Args:
        assets: Assets of the scene, prepared.
        num_envs: Number of environments.
        template: Builder of one environment; bodies of it get shapes.
        load: Makes the builder of an asset.

    Raises:
        ConfigError: for what is no rigid object, and for assets that are not one free body.
    """
    found, problems = list[BodyChoice](), list[str]()
    for asset in assets:
        spawn = asset.cfg.spawn
        if not isinstance(spawn, AssetChoiceCfg):
            continue
        where = f"{type(asset).__name__} '{asset.cfg.prim_path}'"
        if not isinstance(asset, RigidObject):
            wrong = "environments can hold different rigid objects alone, as their bodies and joints must be the same"
            problems.append(f"{where}: {type(spawn).__name__}: {wrong}; use RigidObjectCfg")
            continue
        builders = [load(cfg, asset) for cfg in spawn.assets()]
        reasons = [f"asset {i}: {why}" for i, b in enumerate(builders) if (why := why_no_choice(b))]
        problems += [f"{where}: {reason}" for reason in reasons]
        if not reasons:
            found.append(BodyChoice(template, asset.layout.bodies[0], builders, spawn.choices(num_envs)))
    if problems:
        raise ConfigError(problems)
    return found
