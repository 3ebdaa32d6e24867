# SPDX-License-Identifier: Apache-2.0
"""Represented files: URDF and MJCF files that prims of a stage stand for, and other names of what files bring.

Spawners keep both with the prim, as JSON in its custom data. A stage may come from anybody, so they are read back as
the configs that they were made of, and checked like those.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, TypeVar

import newton
import warp as wp
from pxr import Usd, UsdGeom

from stripe_newton.config_dicts import from_dict
from stripe_newton.configclass import Config, ConfigError
from stripe_newton.robot_files import RobotFileError, import_robot_file, rename_model, split_links
from stripe_newton.sim.spawners.from_files import FILE_KEY, FixedTendonCfg, MjcfFileCfg, UrdfFileCfg
from stripe_newton.sim.spawners.model_names import NAMES_KEY, ModelNamesCfg
from stripe_newton.usd import StageError, StageReport, stage_name
from stripe_newton.value_types import short

__all__ = ["RepresentedFile", "rename_prims", "represented_files"]

C = TypeVar("C", bound=Config)

_FORMATS: dict[str, type[UrdfFileCfg] | type[MjcfFileCfg]] = {"urdf": UrdfFileCfg, "mjcf": MjcfFileCfg}
_FIELDS = {
    "path": "asset_path",
    "enable_self_collisions": "self_collision",
    "collapse_fixed_joints": "merge_fixed_joints",
    "mesh_maxhullvert": "max_hull_vertices",
}
"""Fields of the configs whose option of the importer has another name."""


@dataclasses.dataclass(frozen=True)
class RepresentedFile:
    """A URDF or MJCF file in a stage."""

    prim: Usd.Prim
    format: str
    """``"urdf"`` or ``"mjcf"``."""
    cfg: UrdfFileCfg | MjcfFileCfg
    names: ModelNamesCfg

    def add_to(self, builder: newton.ModelBuilder) -> StageReport:
        """Import the file at the pose of the prim, with labels below its path.

        Raises:
            ValueError: if the file or its names do not fit.
        """
        label = str(self.prim.GetPath())
        pose = UsdGeom.Xformable(self.prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).RemoveScaleShear()
        position, rotation = pose.ExtractTranslation(), pose.ExtractRotationQuat()
        xform = wp.transform(wp.vec3(*position), wp.quat(*rotation.GetImaginary(), rotation.GetReal()))
        try:
            report = import_robot_file(
                builder, self.format, self.cfg.asset_path, self.cfg.importer_options(), xform, label
            )
        except RobotFileError as error:
            raise ValueError(f"{self.format.upper()} file at '{label}': {error}") from error
        split_links(builder, label, self.names.links)
        return report


def represented_files(stage: Usd.Stage, root: str, ignore: tuple[str, ...]) -> list[RepresentedFile]:
    """Files that prims below ``root`` represent.

    Raises:
        StageError: if what is kept with a prim is not what a spawner keeps there.
    """
    return [_file_of(prim) for prim in _prims_with(stage, FILE_KEY, root, ignore)]


def rename_prims(builder: newton.ModelBuilder, stage: Usd.Stage, root: str, ignore: tuple[str, ...]) -> None:
    """Rename what the files of a stage brought.

    Raises:
        ValueError: as :func:`represented_files`, or if names do not fit.
    """
    for prim in _prims_with(stage, NAMES_KEY, root, ignore):
        names = _names_of(prim)
        if names.links and prim.GetCustomDataByKey(FILE_KEY) is None:
            raise _wrong(prim, NAMES_KEY, "links: is set, but shapes of a USD file stay with their bodies")
        rename_model(builder, str(prim.GetPath()), {"bodies": names.bodies, "joints": names.joints})


def _prims_with(stage: Usd.Stage, key: str, root: str, ignore: tuple[str, ...]) -> list[Usd.Prim]:
    """Prims below ``root`` with custom data of a key."""
    prims = (p for p in Usd.PrimRange(stage.GetPrimAtPath(root)) if p.GetCustomDataByKey(key) is not None)
    # Where something is ignored it is what lies in the environments: they are loaded with their own root.
    return [p for p in prims if not (ignore and str(p.GetPath()).startswith("/World/envs"))]


def _file_of(prim: Usd.Prim) -> RepresentedFile:
    data = _data(prim, FILE_KEY)
    kind = data.pop("format", None)
    if not isinstance(kind, str) or kind not in _FORMATS:
        raise _wrong(prim, FILE_KEY, f"format: is {short(kind)}, must be one of {', '.join(_FORMATS)}")
    fields = {_FIELDS.get(name, name): value for name, value in data.items()}
    if "floating" in fields:
        floating = fields.pop("floating")
        fields["fix_base"] = not floating if isinstance(floating, bool) else floating
    tendons = fields.get("fixed_tendons")
    if isinstance(tendons, dict):
        fields["fixed_tendons"] = {
            name: _config(prim, FILE_KEY, FixedTendonCfg, tendon) for name, tendon in tendons.items()
        }
    return RepresentedFile(prim, kind, _config(prim, FILE_KEY, _FORMATS[kind], fields), _names_of(prim))


def _names_of(prim: Usd.Prim) -> ModelNamesCfg:
    """Other names of what the file of a prim brings; none by default."""
    data = _data(prim, NAMES_KEY)
    links = data.get("links")
    if isinstance(links, dict):
        data["links"] = {key: _tuple(value) for key, value in links.items()}
    return _config(prim, NAMES_KEY, ModelNamesCfg, data)


def _data(prim: Usd.Prim, key: str) -> dict[str, Any]:
    text = prim.GetCustomDataByKey(key)
    if text is None:
        return {}
    try:
        found = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise _wrong(prim, key, f"is {short(text)}, must be a JSON object")
    return found


def _config(prim: Usd.Prim, key: str, kind: type[C], fields: object) -> C:
    """The config that the custom data of a prim stand for.

    Raises:
        StageError: with all problems of it.
    """
    if not isinstance(fields, Mapping):
        raise _wrong(prim, key, f"is {short(fields)}, must be a JSON object")
    if "func" in fields:  # what spawns: a file chooses no code
        raise _wrong(prim, key, "'func' is not known")
    cfg = kind()
    try:
        from_dict(cfg, fields)
        cfg.validate()
    except ConfigError as error:
        raise _wrong(prim, key, "; ".join(error.problems)) from None
    return cfg


def _tuple(value: object) -> object:
    """A value that was a tuple: JSON has lists alone."""
    return tuple(value) if isinstance(value, list) else value


def _wrong(prim: Usd.Prim, key: str, reason: str) -> StageError:
    return StageError(stage_name(prim.GetStage()), str(prim.GetPath()), f"custom data '{key}': {reason}")
