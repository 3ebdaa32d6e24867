# SPDX-License-Identifier: Apache-2.0
"""Scene parts: the assets and sensors that a scene's config names, in its fields and in dicts among them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeAlias, TypeVar

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, RigidObjectCollectionCfg, TerrainBaseCfg
from stripe_newton.configclass import MISSING, Config
from stripe_newton.sensors import SensorCfg

__all__ = ["Part", "configured_parts", "part_kind", "with_prim_paths"]

Part: TypeAlias = Any
"""Config of an asset, a terrain or a sensor. They have no common type."""
AnyConfig = TypeVar("AnyConfig", bound=Any)


def configured_parts(cfg: Config, settings: Iterable[str]) -> Iterator[tuple[str, Part]]:
    """Names and configs of all that a scene's config names, in its order. The items of a dict go by their keys.

    Args:
        cfg: The config.
        settings: Fields that are settings rather than parts.
    """
    for name in _part_fields(cfg, settings):
        value = getattr(cfg, name)
        if isinstance(value, Mapping):
            yield from ((key, item) for key, item in value.items() if item is not None)
        elif value is not None and value is not MISSING:
            yield name, value


def _part_fields(cfg: Config, settings: Iterable[str]) -> list[str]:
    """Fields with parts. A scene may have named an asset of its own "scenery", which is a setting otherwise."""
    names = [n for n in type(cfg).__dataclass_fields__ if n not in settings]
    own_scenery = isinstance(getattr(cfg, "scenery", None), AssetBaseCfg)
    return ["scenery", *names] if own_scenery else names


def part_kind(name: str, cfg: Part) -> str | None:
    """Kind of a part: ``"terrain"``, ``"robot"``, ``"object"``, ``"collection"`` or ``"sensor"``; None for others."""
    if name == "terrain" or isinstance(cfg, TerrainBaseCfg):
        return "terrain"
    if isinstance(cfg, ArticulationCfg):
        return "robot"
    if isinstance(cfg, AssetBaseCfg):
        return "object"
    if isinstance(cfg, RigidObjectCollectionCfg):
        return "collection"
    return "sensor" if isinstance(cfg, SensorCfg) and cfg.class_type is not None else None


def with_prim_paths(cfg: AnyConfig, settings: Iterable[str]) -> AnyConfig:
    """A scene's config; if parts of it name no prim, a copy in which they do.

    Args:
        cfg: The config.
        settings: Fields that are settings rather than parts.
    """
    changed: dict[str, object] = {}
    for field in _part_fields(cfg, settings):
        value = getattr(cfg, field)
        one = {field: value} if not isinstance(value, Mapping) else value
        aimed = {name: with_prim_path(name, part) for name, part in one.items()}
        if any(aimed[name] is not part for name, part in one.items()):
            changed[field] = aimed if isinstance(value, Mapping) else aimed[field]
    return cfg.replace(**changed) if changed else cfg


def with_prim_path(name: str, cfg: Part) -> Part:
    """The config of a part; if it names no prim, a copy at ``{ENV_REGEX_NS}/NAME``, with the name in camel case."""
    if isinstance(cfg, RigidObjectCollectionCfg):
        members = {} if cfg.rigid_objects is MISSING else cfg.rigid_objects
        aimed = {key: with_prim_path(f"{name}_{key}", one) for key, one in members.items()}
        return cfg.replace(rigid_objects=aimed) if any(aimed[k] is not members[k] for k in members) else cfg
    if getattr(cfg, "prim_path", None) is not MISSING:
        return cfg
    camel = "".join(word[:1].upper() + word[1:] for word in re.split(r"\W|_", name))
    return cfg.replace(prim_path=f"{{ENV_REGEX_NS}}/{camel}")
