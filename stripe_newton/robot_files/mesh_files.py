# SPDX-License-Identifier: Apache-2.0
"""Mesh files of robots: found by path or by the name of their ROS package, and checked before they are read."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

from stripe_newton.input_files import why_no_file

from .file_kind import file_kind

__all__ = ["MeshFiles", "mesh_problem"]

_READABLE = (".stl", ".obj", ".dae", ".glb", ".gltf", ".ply", ".off", ".msh")
"""Suffixes of the meshes that Newton's importers read, by trimesh and themselves."""


class MeshFiles:
    """Finds the files that a URDF file names.

    A package is looked for in ``packages``, then in ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH`` (for ``model://``:
    ``GZ_SIM_RESOURCE_PATH`` and ``GAZEBO_MODEL_PATH``), then upwards from the URDF file: a folder of its name, one
    that contains such a folder, or one whose ``package.xml`` has the name.
    """

    def __init__(self, urdf: Path, packages: Mapping[str, str] | None = None):
        """Prepare for the names in one file.

        Args:
            urdf: The file.
            packages: Folder of a package by its name.
        """
        self._urdf, self._packages = urdf.absolute(), dict(packages or {})
        self._found: dict[tuple[str, str], Path | None] = {}

    def find(self, name: str) -> Path:
        """Path of the file that is called ``name``, which may begin with ``package://``, ``model://`` or ``file://``.

        Raises:
            LookupError: its package is not found, or it is not on this machine; the message says what to do.
        """
        scheme, separator, rest = name.partition("://")
        if not separator:
            return self._urdf.parent / name
        if scheme == "file":
            return Path(unquote(urlsplit(name).path))
        if scheme in ("http", "https"):
            raise LookupError(f"'{name}' is on the web, which is not read; download it and give a path")
        if scheme not in ("package", "model"):
            raise LookupError(f"'{name}' has the scheme '{scheme}://'; give a path, package://, model:// or file://")
        package, _, inside = rest.partition("/")
        folder = self._package(scheme, package)
        if folder is None:
            where = "ROS_PACKAGE_PATH, AMENT_PREFIX_PATH" if scheme == "package" else "GZ_SIM_RESOURCE_PATH"
            raise LookupError(
                f"'{name}': package '{package}' is neither in packages, {where} nor above the file; "
                f"set packages={{'{package}': 'FOLDER'}}, or one of these variables"
            )
        return folder / inside

    def _package(self, scheme: str, name: str) -> Path | None:
        key = scheme, name
        if key not in self._found:
            self._found[key] = next((p for p in self._candidates(scheme, name) if p.is_dir()), None)
        return self._found[key]

    def _candidates(self, scheme: str, name: str) -> Iterator[Path]:
        if name in self._packages:
            yield Path(self._packages[name]).expanduser()
        variables = {"package": ("ROS_PACKAGE_PATH",), "model": ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH")}[scheme]
        for folder in (Path(f) for v in variables for f in os.environ.get(v, "").split(os.pathsep) if f):
            # By ROS's rules an entry is a package itself, or has packages somewhere below.
            if folder.name == name or _manifest_name(folder) == name:
                yield folder
            yield folder / name
            yield from (manifest.parent for manifest in sorted(folder.rglob(f"{name}/package.xml")))
        if scheme == "package":
            for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
                yield Path(prefix) / "share" / name
        for folder in self._urdf.parents:
            if folder.name == name or _manifest_name(folder) == name:
                yield folder
            yield folder / name


def _manifest_name(folder: Path) -> str:
    """Name of the ROS package whose manifest lies in a folder; empty without one."""
    try:
        return (ElementTree.parse(folder / "package.xml").getroot().findtext("name") or "").strip()
    except (OSError, ElementTree.ParseError):
        return ""


def mesh_problem(path: Path) -> str:
    """Reason why a mesh file cannot be read; empty if it can."""
    if problem := why_no_file(path):
        return f"mesh '{path}' {problem}"
    if path.suffix.lower() not in _READABLE:
        return f"mesh '{path}' is none of {', '.join(_READABLE)}; convert it"
    kind = file_kind(path)
    if kind.name != "mesh":
        return f"mesh '{path}' {kind.description}"
    if path.suffix.lower() == ".dae" and importlib.util.find_spec("collada") is None:
        return f"mesh '{path}' is a Collada file, which needs pycollada: pip install pycollada"
    return ""
