# SPDX-License-Identifier: Apache-2.0
"""File kind: what a file is by its content, whatever its name says."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from stripe_newton.input_files import why_no_file
from stripe_newton.usd.git_lfs import POINTER_REASON, is_pointer

__all__ = ["XACRO", "FileKind", "file_kind"]

XACRO = "{http://www.ros.org/wiki/xacro}"
"""Namespace of xacro's elements."""

_MAGIC = (
    (b"#usda", "usd", "is a USD stage"),
    (b"PXR-USDC", "usd", "is a USD stage"),
    (b"glTF", "mesh", "is a glTF mesh"),
    (b"ply\n", "mesh", "is a PLY mesh"),
    (b"ply\r", "mesh", "is a PLY mesh"),
    (b"Kaydara FBX", "mesh", "is an FBX mesh"),
    (b"\x89PNG", "", "is a PNG picture"),
    (b"\xff\xd8\xff", "", "is a JPEG picture"),
    (b"\x1f\x8b", "", "is a gzip archive; unpack it"),
    (b"\xfd7zXZ", "", "is an xz archive; unpack it"),
    (b"MJB\0", "", "is a compiled MuJoCo model; give the MJCF file that it was made from"),
)
_MESH_SUFFIXES = {".stl": "an STL mesh", ".obj": "an OBJ mesh", ".msh": "a mesh of MuJoCo", ".dae": "a Collada mesh"}
_MESH_ADVICE = "name it in the <mesh> of a URDF or MJCF file, or reference it from a USD stage"


@dataclass
class FileKind:
    """Kind of a file."""

    name: str
    """``"usd"``, ``"urdf"``, ``"mjcf"``, ``"mesh"``; empty for anything else."""
    description: str
    """Predicate for messages: what it is, and what would be right where it is no robot or scene."""


def file_kind(path: str | Path) -> FileKind:
    """Find out what a file is.

    Raises:
        FileNotFoundError: there is no such file.
    """
    path = Path(path)
    if path.exists() and (problem := why_no_file(path)):  # reading a pipe would wait for somebody who writes it
        return FileKind("", problem)
    if is_pointer(path):
        return FileKind("", POINTER_REASON)
    with open(path, "rb") as file:
        start = file.read(4096)
    for magic, name, text in _MAGIC:
        if start.startswith(magic):
            return FileKind(name, f"{text}; {_MESH_ADVICE}" if name == "mesh" else text)
    suffix = path.suffix.lower()
    if start.startswith(b"PK\x03\x04"):
        return FileKind("usd", "is a USD package") if suffix == ".usdz" else FileKind("", "is a zip archive; unpack it")
    if re.match(rb"(\xef\xbb\xbf)?\s*<", start):
        return _xml_kind(path)
    if suffix in _MESH_SUFFIXES:
        return FileKind("mesh", f"is {_MESH_SUFFIXES[suffix]}; {_MESH_ADVICE}")
    if not start.strip():
        return FileKind("", "is empty")
    return FileKind("", "is no USD, URDF or MJCF file" + ("" if b"\0" in start else f": it begins with {_line(start)}"))


def _line(start: bytes) -> str:
    return repr(start.decode(errors="replace").strip().splitlines()[0][:60])


def _xml_kind(path: Path) -> FileKind:
    try:
        tags = list(_tags(path))
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        return FileKind("", f"is not well-formed XML: {error}")
    root = tags[0].rpartition("}")[2].lower()
    if root == "robot" and any(tag.startswith(XACRO) for tag in tags):
        command = f"xacro {path.name} > {path.name.removesuffix('.xacro').removesuffix('.urdf')}.urdf"
        return FileKind("", f"is a xacro file, a template of a URDF file; expand it with '{command}'")
    kinds = {
        "robot": FileKind("urdf", "is a URDF file"),
        "mujoco": FileKind("mjcf", "is an MJCF file"),
        "mujocoinclude": FileKind(
            "", "is a part of an MJCF file, which others include; give the file with the root <mujoco>"
        ),
        "sdf": FileKind("", "is an SDF file of Gazebo, which is not read; convert it to URDF or MJCF"),
        "collada": FileKind("mesh", f"is a Collada mesh; {_MESH_ADVICE}"),
        "package": FileKind("", "is the manifest of a ROS package; its robots are in its folder urdf or robots"),
    }
    return kinds.get(root, FileKind("", f"is an XML file with the root <{root}>, no <robot> (URDF) or <mujoco> (MJCF)"))


def _tags(path: Path) -> Iterator[str]:
    """Tags of all elements, the root's first."""
    for _, element in ElementTree.iterparse(path, events=("start",)):
        yield element.tag
