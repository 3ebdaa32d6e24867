# SPDX-License-Identifier: Apache-2.0
"""Files of NVIDIA's asset server by name: the spawner of the robot or prop that stands for one.

The tables are in :mod:`stripe_newton.isaaclab.names.nucleus`. A log line says what stands for a file, once for each.
"""

from __future__ import annotations

import dataclasses
import logging
import re
from functools import cache
from pathlib import Path
from typing import Any

from newton.examples import get_asset

from stripe_newton import sim as native
from stripe_newton.actuators import ActuatorCfg, ActuatorNetLSTMCfg, DCMotorCfg
from stripe_newton.assets import ROBOTS as LIBRARY
from stripe_newton.assets import file_spawner, find_robot
from stripe_newton.configclass import resolve_name

from .files import ASSETS_VARIABLE, ISAAC_NUCLEUS_DIR, NUCLEUS_ASSET_ROOT_DIR, is_on_server, local_copy
from .names.nucleus import ABSENT, ACTUATOR_NETS, POINTERS, PROPS, ROBOTS, Pointer, Prop, Robot

__all__ = ["actuator_for", "joint_order_for", "problem_of", "robot_for", "spawner_for"]

_log = logging.getLogger(__name__)
_MODELS = Path(__file__).parent / "models"
_ENTRIES: tuple[Robot | Prop | Pointer, ...] = (*ROBOTS, *PROPS, *POINTERS)
_BY_PATH = {path: entry for entry in _ENTRIES for path in entry.paths}


def problem_of(path: str) -> str | None:
    """Why nothing can stand for a file of the server, and what to do about it; None if something does."""
    if local_copy(path) is not None:
        return None
    inside = _inside(path)
    entry = _BY_PATH.get(inside)
    if entry is None:
        reason = next(text for e, text in ABSENT.items() if re.fullmatch(e, inside))
        return f"'{inside}': {reason}, or set {ASSETS_VARIABLE} to a folder with files of the server"
    if isinstance(entry, Robot) and entry.name and not entry.file:
        try:
            _file_of(entry.name)
        except LookupError as error:
            return f"'{inside}' stands for a file that is not on this machine: {error}"
    return None


def spawner_for(cfg: native.UsdFileCfg) -> native.SpawnerCfg:
    """The spawner of what stands for ``cfg.usd_path``, with the properties that ``cfg`` sets.

    Raises:
        FileNotFoundError: nothing stands for the file; the message says how to get one.
    """
    if (problem := problem_of(cfg.usd_path)) is not None:
        raise FileNotFoundError(problem)
    if (copy := local_copy(cfg.usd_path)) is not None:
        return cfg.replace(usd_path=copy)
    path = _inside(cfg.usd_path)
    entry = _BY_PATH[path]
    if isinstance(entry, Prop):
        _say(path, entry.note)
        return _prop(entry, cfg)
    if isinstance(entry, Pointer):
        return _pointer(entry, cfg)
    title = LIBRARY[entry.name].title if entry.name else ""
    _say(path, "; ".join(text for text in (title, entry.note) if text))
    return _robot(entry, cfg)


def actuator_for(cfg: ActuatorCfg) -> ActuatorCfg:
    """The actuator itself, or a DC motor with its limits in place of a network whose file only the server has."""
    if not isinstance(cfg, ActuatorNetLSTMCfg) or not is_on_server(cfg.network_file):
        return cfg
    if (copy := local_copy(cfg.network_file)) is not None:
        return cfg.replace(network_file=copy)
    path = _inside(cfg.network_file)
    if path not in ACTUATOR_NETS:
        return cfg
    stiffness, damping = ACTUATOR_NETS[path]
    _say(path, f"a PD law with stiffness {stiffness:g} and damping {damping:g} and the network's limits")
    own = {f.name: getattr(cfg, f.name) for f in dataclasses.fields(DCMotorCfg)}
    return DCMotorCfg(**own | {"stiffness": stiffness, "damping": damping})


def joint_order_for(spawn: native.SpawnerCfg | None) -> tuple[str, ...] | None:
    """Names of the joints in the order of NVIDIA's file where that is not by depth and name; else None."""
    path = getattr(spawn, "usd_path", "")
    entry = _BY_PATH.get(_inside(path)) if isinstance(path, str) and is_on_server(path) else None
    return entry.order if isinstance(entry, Robot) and entry.order else None


def robot_for(spawn: object) -> Robot | None:
    """The entry of the robot that stands for the file of a spawner; None for other spawners and files."""
    path = getattr(spawn, "usd_path", "")
    if not isinstance(path, str) or not is_on_server(path) or local_copy(path) is not None:
        return None
    entry = _BY_PATH.get(_inside(path))
    return entry if isinstance(entry, Robot) else None


def _inside(path: str) -> str:
    """The path below the folder of Isaac Sim's files."""
    return path.removeprefix(ISAAC_NUCLEUS_DIR).removeprefix(NUCLEUS_ASSET_ROOT_DIR).lstrip("/")


@cache
def _say(path: str, text: str) -> None:
    _log.warning("for %s of NVIDIA's server stands: %s", path, text)


def _path_of(entry: Robot) -> str:
    """The file that stands for NVIDIA's."""
    if entry.asset:
        return str(get_asset(entry.asset))
    try:
        if entry.name:
            return str(_file_of(entry.name))
    except LookupError:
        if not entry.file:
            raise
    return str(_MODELS / entry.file)


@cache
def _file_of(name: str) -> Path:
    return find_robot(name)


def _robot(entry: Robot, cfg: native.UsdFileCfg) -> native.SpawnerCfg:
    if entry.cfg:
        return resolve_name(entry.cfg)(visible=cfg.visible, semantic_tags=cfg.semantic_tags)
    names = native.ModelNamesCfg(joints=dict(entry.joints), bodies=dict(entry.bodies), links=dict(entry.links))
    shared: dict[str, Any] = {
        "visible": cfg.visible,
        "semantic_tags": cfg.semantic_tags,
        "names": names,
        "articulation_props": _held(cfg.articulation_props, entry.fixed_base),
        "rigid_props": cfg.rigid_props,
    }
    path = _path_of(entry)
    if path.endswith((".usd", ".usda", ".usdc", ".usdz")):
        mass = native.MassPropertiesCfg(density=entry.density) if entry.density else None
        own = {name: getattr(cfg, name) for name in ("scale", "collision_props", "joint_drive_props")}
        return native.UsdFileCfg(usd_path=path, mass_props=cfg.mass_props or mass, **own, **shared)
    # Drives are those of the config alone, as in a file of NVIDIA's.
    tendons = {
        name: native.FixedTendonCfg(coefficients=dict(coefficients), limits=limits)
        for name, (coefficients, limits) in entry.tendons.items()
    }
    of_mjcf = {"actuators": entry.drives, "root_pose": entry.root, "fixed_tendons": tendons}
    return file_spawner(path, scale=_uniform(cfg), **(of_mjcf if path.endswith(".xml") else {}), **shared)


def _held(
    props: native.ArticulationRootPropertiesCfg | None, fixed: bool | None
) -> native.ArticulationRootPropertiesCfg | None:
    """The properties, with a base that is held as in NVIDIA's file unless they say otherwise."""
    if fixed is None or (props is not None and props.fix_root_link is not None):
        return props
    return (native.ArticulationRootPropertiesCfg() if props is None else props).replace(fix_root_link=fixed)


def _uniform(cfg: native.UsdFileCfg) -> float:
    """The scale of a robot as one number.

    Raises:
        ValueError: it is not the same along all axes.
    """
    if cfg.scale is None:
        return 1.0
    if len(set(cfg.scale)) != 1:
        raise ValueError(f"scale {cfg.scale}: the robot that stands for '{cfg.usd_path}' is scaled by one number")
    return float(cfg.scale[0])


def _prop(entry: Prop, cfg: native.UsdFileCfg) -> native.SpawnerCfg:
    (a, b, c), (x, y, z) = entry.size, cfg.scale or (1.0, 1.0, 1.0)
    u, v, w = entry.center
    movable = entry.movable or cfg.rigid_props is not None
    return native.CuboidCfg(
        func=_CenteredShape((u * x, v * y, w * z)),
        size=(a * x, b * y, c * z),
        rigid_props=(cfg.rigid_props or native.RigidBodyPropertiesCfg()) if movable else None,
        mass_props=cfg.mass_props,
        collision_props=cfg.collision_props or native.CollisionPropertiesCfg(),
        visual_material=cfg.visual_material or native.PreviewSurfaceCfg(diffuse_color=entry.color),
        visible=cfg.visible,
        semantic_tags=cfg.semantic_tags,
    )


def _pointer(entry: Pointer, cfg: native.UsdFileCfg) -> native.SpawnerCfg:
    shared: dict[str, Any] = {"scale": cfg.scale, "visible": cfg.visible, "semantic_tags": cfg.semantic_tags}
    if entry.kind == "frame":
        return native.FrameCfg(**shared)
    return native.ArrowCfg(visual_material=cfg.visual_material, **shared)


class _CenteredShape:
    """Spawns a shape whose centre is not the origin of its prim."""

    def __init__(self, center: tuple[float, ...]):
        self.center = center

    def __call__(self, prim_path: str, cfg: native.ShapeCfg, translation: Any = None, orientation: Any = None) -> Any:
        prim = native.spawn_shape(prim_path, cfg, translation, orientation)
        if any(self.center):
            from pxr import UsdGeom  # with the first scene, not with the configs of a task

            geometry = prim.GetStage().GetPrimAtPath(f"{prim.GetPath()}/geometry/mesh")
            if not UsdGeom.XformCommonAPI(geometry).SetTranslate(self.center):
                raise RuntimeError(f"the shape at '{geometry.GetPath()}' cannot be moved")
        return prim
