# SPDX-License-Identifier: Apache-2.0
"""What a stage says beside physics: lights and semantic labels."""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Usd, UsdGeom, UsdLux

from .lights import Light
from .stage import open_stage, walk

__all__ = ["ignored_lights", "read_lights", "read_semantics"]


def read_lights(source: str | Path | Usd.Stage, root_path: str = "/") -> list[Light]:
    """The dome and distant lights of a stage, in the simulation's frame (Z up), in stage order.

    Intensity includes exposure (a factor of two a stop), colour includes the colour temperature where it is enabled.
    Invisible lights are left out. Other kinds of light are not read: see :func:`ignored_lights`.
    """
    stage = open_stage(source)
    to_z_up = Gf.Rotation(Gf.Vec3d(0.0, 0.0, 1.0), 0.0)  # the default constructor leaves it undefined
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        to_z_up = Gf.Rotation(Gf.Vec3d(1, 0, 0), 90.0)
    lights = []
    for prim in walk(stage, root_path):
        dome = _is_dome(prim)
        if (
            not (dome or prim.IsA(UsdLux.DistantLight))
            or UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible
        ):
            continue
        api = UsdLux.LightAPI(prim)
        color = Gf.Vec3f(api.GetColorAttr().Get())
        if api.GetEnableColorTemperatureAttr().Get():
            color = Gf.CompMult(color, UsdLux.BlackbodyTemperatureAsRgb(api.GetColorTemperatureAttr().Get()))
        world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        direction = to_z_up.TransformDir(world.TransformDir(Gf.Vec3d(0, 0, -1))).GetNormalized()
        lights.append(
            Light(
                kind="dome" if dome else "distant",
                color=(float(color[0]), float(color[1]), float(color[2])),
                intensity=float(api.GetIntensityAttr().Get() * 2.0 ** api.GetExposureAttr().Get()),
                direction=(float(direction[0]), float(direction[1]), float(direction[2])),
                path=str(prim.GetPath()),
            )
        )
    return lights


def ignored_lights(stage: Usd.Stage, root_path: str = "/") -> list[tuple[str, str, str]]:
    """``(path, what, why)`` of the lights that :func:`read_lights` passes over."""
    rows = []
    for prim in walk(stage, root_path):
        if not (prim.HasAPI(UsdLux.LightAPI)) or prim.IsA(UsdLux.LightFilter):
            continue
        path, what = str(prim.GetPath()), prim.GetTypeName() or "light"
        if not (_is_dome(prim) or prim.IsA(UsdLux.DistantLight)):
            rows.append((path, what, "only dome and distant lights are rendered"))
        elif UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible:
            rows.append((path, what, "invisible"))
        elif _is_dome(prim) and prim.GetAttribute("inputs:texture:file").Get():
            rows.append((path, "dome texture", "the dome is rendered in one colour"))
    return rows


def _is_dome(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DomeLight_1)


def read_semantics(source: str | Path | Usd.Stage, root_path: str = "/") -> dict[str, dict[str, list[str]]]:
    """Semantic labels: ``{prim path: {type: [labels]}}``, of the prims that author some.

    Reads ``UsdSemantics.LabelsAPI`` (``semantics:labels:<type>``) and the older pairs of attributes
    ``semantic:<name>:params:semanticType`` / ``semanticData``, several labels of which are separated by commas.
    """
    stage = open_stage(source)
    found: dict[str, dict[str, list[str]]] = {}
    for prim in walk(stage, root_path):
        labels: dict[str, list[str]] = {}
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if name.startswith("semantics:labels:"):
                _add(labels, name.removeprefix("semantics:labels:"), list(attribute.Get() or []))
            elif name.startswith("semantic:") and name.endswith(":params:semanticType"):
                data = prim.GetAttribute(name.removesuffix("semanticType") + "semanticData")
                text = data.Get() if data else None
                if attribute.Get() and text:
                    _add(labels, attribute.Get(), [part.strip() for part in text.split(",")])
        if labels:
            found[str(prim.GetPath())] = labels
    return found


def _add(labels: dict[str, list[str]], kind: str, values: list[str]) -> None:
    present = labels.setdefault(kind, [])
    present.extend(str(value) for value in values if str(value) not in present)
