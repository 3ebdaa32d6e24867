# SPDX-License-Identifier: Apache-2.0
"""MJCF edits: what of a file is read differently than it is written, and what is added to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
from newton._src.utils.import_mjcf import _load_and_expand_mjcf  # its includes and asset folders, as it reads them

from .error import RobotFileError
from .mjcf_checks import compile_mjcf
from .mjcf_frames import empty_frames
from .numbers import numbers_of

__all__ = ["edit_mjcf"]


def edit_mjcf(
    path: Path,
    actuators: bool,
    tendons: Mapping[str, Mapping[str, Any]],
    condim: int | None = None,
    solimp: Sequence[float] | None = None,
) -> tuple[str, mujoco.MjModel]:
    """Edit a file for Newton's importer, and compile MuJoCo's model of it.

    Where the file's outermost ``<default>`` names its class, as ``"main"``, Newton would keep these defaults for
    elements that name the class, where MuJoCo gives them to all: the name is left out. A joint whose ``range`` is empty
    (``"0 0"``) has no limits for MuJoCo, unless it says that it is limited; for Newton it would be locked. Joints and
    bodies in frames become those of the body around (:func:`empty_frames`).

    Args:
        path: The file.
        actuators: Whether the file's actuators are read.
        tendons: Fixed tendons to add by name: fields of ``FixedTendonCfg``.
        condim: Dimension of the contacts of all geoms; None as the file has it.
        solimp: Impedance of the contacts of all geoms, five numbers; None as the file has it.

    Returns:
        The path, or XML with what is changed; and the model of the file, with the added tendons.

    Raises:
        RobotFileError: MuJoCo refuses the file or a tendon.
    """
    model = compile_mjcf(path)
    root, _ = _load_and_expand_mjcf(str(path.resolve()))
    changed = [default for default in root.findall("default") if default.attrib.pop("class", None) is not None]
    changed += [*empty_frames(root, model), *_open_empty_ranges(root), *_find_assets(root, path)]
    changed += _write_height_fields(root, model)
    if tendons:
        changed.append(_add_tendons(root, tendons))
        try:
            model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
        except ValueError as error:
            raise RobotFileError(path, [f"fixed_tendons: {' '.join(str(error).split())}"]) from error
    contacts = {"condim": None if condim is None else [condim], "solimp": solimp}
    for name, values in contacts.items():
        if values is None:
            continue
        for geom in root.iter("geom"):  # those of default classes are among them
            geom.set(name, " ".join(f"{value:.9g}" for value in values))
            changed.append(geom)
        getattr(model, f"geom_{name}")[:] = values if len(values) > 1 else values[0]
    if not actuators:
        for section in root.findall("actuator"):
            root.remove(section)
            changed.append(section)
    return (ElementTree.tostring(root, encoding="unicode") if changed else str(path)), model


def _find_assets(root: ElementTree.Element, path: Path) -> list[ElementTree.Element]:
    """Find the files of assets that Newton looks for elsewhere than MuJoCo; returns their elements.

    A ``<compiler>`` holds for the whole model in MuJoCo, so that ``meshdir`` of the file is that of what it includes.
    For Newton a folder that an included file names wins there.
    """
    tags = ("mesh", "hfield", "texture")
    lost = [e for tag in tags for e in root.iter(tag) if (file := e.get("file")) and not (path.parent / file).is_file()]
    if not lost:
        return []
    spec = mujoco.MjSpec.from_file(str(path))
    folders = {"mesh": spec.meshdir, "hfield": spec.meshdir, "texture": spec.texturedir}
    files = {"mesh": spec.meshes, "hfield": spec.hfields, "texture": spec.textures}
    found = []
    for element in lost:
        name = element.get("name") or Path(element.get("file", "")).stem
        original = next(
            (asset.file for asset in files[element.tag] if (asset.name or Path(asset.file).stem) == name), ""
        )
        place = (path.parent / folders[element.tag] / original).resolve()
        if original and place.is_file():
            element.set("file", str(place))
            found.append(element)
    return found


def _write_height_fields(root: ElementTree.Element, model: mujoco.MjModel) -> list[ElementTree.Element]:
    """Write down the heights of fields whose files Newton reads otherwise than MuJoCo; returns their elements.

    Newton takes 100 rows and columns where none are given, leaves a field without a name out, and reads pictures of
    16 bits as of 8. MuJoCo makes large ones smaller.
    """
    found = []
    for element in root.iter("hfield"):
        name = element.get("name") or Path(element.get("file", "")).stem
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_HFIELD, name)
        if not element.get("file") or number < 0:
            continue
        rows, columns, start = (int(a[number]) for a in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
        heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)[::-1]  # the first is last
        del element.attrib["file"]
        element.attrib |= {"name": name, "nrow": str(rows), "ncol": str(columns)}
        element.set("elevation", " ".join(f"{height:.9g}" for height in heights.reshape(-1)))
        found.append(element)
    return found


def _open_empty_ranges(root: ElementTree.Element) -> list[ElementTree.Element]:
    """Say of joints with an empty range that they are not limited, as MuJoCo reads it; returns these joints."""
    worlds = root.findall("worldbody")
    empty = [
        joint
        for world in worlds
        for joint in world.iter("joint")
        if joint.get("limited", "auto") == "auto" and len(set(ends := numbers_of(joint, "range"))) == 1 < len(ends)
    ]
    for joint in empty:
        joint.set("limited", "false")
    return empty


def _add_tendons(root: ElementTree.Element, tendons: Mapping[str, Mapping[str, Any]]) -> ElementTree.Element:
    """Add fixed tendons to a file; returns their section."""
    section = ElementTree.SubElement(root, "tendon")
    for name, tendon in tendons.items():
        fixed = ElementTree.SubElement(section, "fixed", {"name": name})
        fixed.attrib |= {key: f"{tendon[key]:.9g}" for key in ("stiffness", "damping")}
        if tendon["limits"] is not None:
            low, high = tendon["limits"]
            fixed.attrib |= {"limited": "true", "range": f"{low:.9g} {high:.9g}"}
        for joint, coefficient in tendon["coefficients"].items():
            ElementTree.SubElement(fixed, "joint", {"joint": joint, "coef": f"{coefficient:.9g}"})
    return section
