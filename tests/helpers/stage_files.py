# SPDX-License-Identifier: Apache-2.0
"""Stage files: the scenes that come with the installed packages, and copies of stages with other units and contents."""

from __future__ import annotations

import importlib.util
import os
import random
import re
from dataclasses import dataclass, field
from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade

PACKAGES = ("newton", "warp", "mujoco", "mujoco_warp", "gymnasium")
"""Dependencies whose wheels have USD, URDF and MJCF files."""
FURTHER = ("mjlab", "gymnasium_robotics", "robosuite", "mani_skill", "dm_control")
"""Packages whose files are tried, too, where they are installed."""
MENAGERIE = "MENAGERIE_ROOT"
"""Environment variable: a folder of MJCF files that are tried, too."""
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz", ".urdf", ".xml")
_FIRST = "/World/envs/env_0"
_COPY = re.compile(r"/World/envs/env_[1-9]")
"""Prims of further environments, which are copies of the first."""


def package_files(names: tuple[str, ...] = PACKAGES) -> list[tuple[str, Path]]:
    """``(name, path)`` of every file with a suffix of a scene in the packages that are installed."""
    found = []
    for name in names:
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.origin is not None:
            folder = Path(spec.origin).parent
            found += [(f"{name}/{p.relative_to(folder).as_posix()}", p) for p in _scenes(folder)]
    return found


def further_files() -> list[tuple[str, Path]]:
    """``(name, path)`` of the files of packages that need not be installed, and those below ``MENAGERIE_ROOT``."""
    folder = os.environ.get(MENAGERIE, "")
    menagerie = [(p.relative_to(folder).as_posix(), p) for p in _scenes(Path(folder))] if folder else []
    return package_files(FURTHER) + menagerie


def _scenes(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES and path.is_file())


@dataclass
class Dressed:
    """A stage with other units and more contents than its file, and what was authored on it."""

    stage: Usd.Stage
    speeds: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Linear and angular speed by path of a body [m/s, rad/s]."""
    labels: dict[str, list[str]] = field(default_factory=dict)
    frictions: dict[str, float] = field(default_factory=dict)
    """Friction by path of a material."""


def dressed(file: Path, metres: float, up: str, seed: int = 0) -> Dressed:
    """A copy of a stage in memory, in other units, with bodies in motion, labels and physics materials.

    The numbers of its geometry and physics stay, so that a robot in centimetres is a small one.

    Args:
        file: The stage.
        metres: Metres of its unit of length.
        up: Its up axis, ``"Y"`` or ``"Z"``.
        seed: Of the random numbers.
    """
    draw = random.Random(seed)
    layer = Usd.Stage.Open(str(file)).Flatten()
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    UsdGeom.SetStageUpAxis(stage, up)
    made = Dressed(stage)
    for number, prim in enumerate(list(stage.Traverse())):
        if _COPY.match(str(prim.GetPath())):
            continue
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            _set_in_motion(prim, number, metres, draw, made)
        elif prim.HasAPI(UsdPhysics.CollisionAPI):
            _bind_material(prim, number, draw, made)
    return made


def _set_in_motion(prim: Usd.Prim, number: int, metres: float, draw: random.Random, made: Dressed) -> None:
    """Give a body a velocity: every other one turns, the rest move straight on, as the point of a velocity matters."""
    direction = Gf.Vec3f(*(draw.gauss(0.0, 1.0) for _ in range(3))).GetNormalized()
    speed, turns = (draw.uniform(0.1, 1.0), 0.0) if number % 2 else (0.0, draw.uniform(10.0, 60.0))
    body = UsdPhysics.RigidBodyAPI(prim)
    body.CreateVelocityAttr(direction * (speed / metres))
    body.CreateAngularVelocityAttr(direction * turns)
    made.speeds[str(prim.GetPath())] = speed, turns * 3.141592653589793 / 180.0
    made.labels[str(prim.GetPath())] = [f"body{number}", "thing"]
    UsdSemantics.LabelsAPI.Apply(prim, "category").CreateLabelsAttr(made.labels[str(prim.GetPath())])


def _bind_material(prim: Usd.Prim, number: int, draw: random.Random, made: Dressed) -> None:
    """Bind a physics material of its own to a collider that has none."""
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if bound and bound.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        return
    stage = prim.GetStage()
    # A report lists the materials below its root, which is the first environment where there is one.
    path = Sdf.Path(f"{_FIRST if stage.GetPrimAtPath(_FIRST) else ''}/materials/material{number}")
    material = UsdShade.Material.Define(stage, path)
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    made.frictions[str(path)] = draw.uniform(0.2, 1.5)
    api.CreateStaticFrictionAttr(made.frictions[str(path)])
    api.CreateDynamicFrictionAttr(made.frictions[str(path)])
    UsdShade.MaterialBindingAPI.Apply(prim)
    UsdShade.MaterialBindingAPI(prim).Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
