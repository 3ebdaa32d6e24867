# SPDX-License-Identifier: Apache-2.0
"""URDF files: checked, and completed where Newton's importer would read them otherwise."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from copy import deepcopy
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from stripe_newton.input_files import why_no_file

from .error import RobotFileError
from .mesh_files import MeshFiles, mesh_problem
from .numbers import number_problems
from .urdf_checks import UNREAD, Row, massless_links, part_problems, urdf_problems, urdf_rows
from .urdf_unread import unread_rows

__all__ = ["prepare_urdf"]


def prepare_urdf(
    path: Path,
    floating: bool | None,
    packages: Mapping[str, str] | None = None,
    visuals_collide: bool = False,
    custom: Collection[str] = (),
) -> tuple[str, list[Row]]:
    """Read a URDF file as it will be imported.

    Names of meshes and textures become paths, visual meshes that are missing are left out, and ``continuous`` joints
    lose their limits.

    Args:
        path: The file.
        floating: Whether its root link floats, as the config says; None leaves it to the file.
        packages: Folder of a ROS package by its name.
        visuals_collide: Whether visual geometry is collided with.
        custom: Attributes beyond those of URDF that Newton reads.

    Returns:
        XML for Newton's importer, and rows of what is left out, read differently or changed.

    Raises:
        RobotFileError: everything that is wrong with the file.
    """
    robot = ElementTree.parse(path).getroot()
    for capsule in robot.iter("capsule"):
        if capsule.get("height") is None and (length := capsule.get("length")) is not None:
            capsule.set("height", length)  # URDF's name for what Newton's importer calls its height
    problems, rows = list(urdf_problems(robot, floating)), list[Row]()
    files = MeshFiles(path, packages)
    for link in robot.findall("link"):
        problems += [f"link '{link.get('name')}': {p}" for p in _resolve_parts(link, files, visuals_collide, rows)]
    if problems:
        raise RobotFileError(path, problems)
    rows[:0] = [*urdf_rows(robot), *unread_rows(robot, UNREAD, custom)]
    massless = list(massless_links(robot))
    for link in robot.findall("link"):
        if link.get("name") in massless:
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", {"value": "0"})
            zeros = dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0")
            ElementTree.SubElement(inertial, "inertia", zeros)
    for material in robot.iter("material"):
        _resolve_texture(material, files, rows)
        color = material.find("color")
        if color is not None and (problem := next(number_problems(color, "rgba", 4), "")):
            rows.append((material.get("name", ""), "<color>", f"left out: {problem}"))
            material.remove(color)
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") == "continuous" and limit is not None:
            limit.attrib.pop("lower", None)
            limit.attrib.pop("upper", None)
        if joint.get("type") == "fixed" and (mimic := joint.find("mimic")) is not None:
            joint.remove(mimic)
    return ElementTree.tostring(robot, encoding="unicode"), rows


def _resolve_parts(link: Element, files: MeshFiles, visuals_collide: bool, rows: list[Row]) -> Iterator[str]:
    """Replace names of meshes by paths; yields what is wrong with parts that are collided with.

    A link of which nothing is left to see is drawn by its colliders.
    """
    left_out = False
    for part in [*link.findall("collision"), *link.findall("visual")]:
        mesh = part.find("geometry/mesh")
        problems = [] if part.tag == "collision" else list(part_problems(part))  # of colliders they are known
        if mesh is not None and mesh.get("filename") and (problem := _resolve(mesh, files)):
            problems.append(problem)
        if part.tag == "collision" or visuals_collide:
            yield from (f"<{part.tag}>: {problem}" for problem in problems)
        elif problems:  # it is for pictures alone: the physics is that of the file without it
            rows.append((link.get("name", ""), "<visual>", f"left out: {problems[0]}"))
            link.remove(part)
            left_out = True
    if left_out and link.find("visual") is None:
        for part in link.findall("collision"):
            seen = deepcopy(part)
            seen.tag = "visual"
            seen.attrib.pop("name", None)
            link.append(seen)


def _resolve(element: Element, files: MeshFiles) -> str:
    """Replace the name of a mesh by its path; returns what is wrong with it."""
    try:
        path = files.find(element.get("filename", ""))
    except LookupError as error:
        return f"mesh {error.args[0]}"
    element.set("filename", str(path))
    return mesh_problem(path)


def _resolve_texture(material: Element, files: MeshFiles, rows: list[Row]) -> None:
    texture = material.find("texture")
    name = None if texture is None else texture.get("filename")
    if texture is None or not name:
        return
    try:
        path = files.find(name)
        problem = why_no_file(path)
        reason = f"'{path}' {problem}" if problem else ""
    except LookupError as error:
        path, reason = Path(name), error.args[0]
    if reason:
        rows.append((material.get("name", ""), "texture", f"left out: {reason}"))
        material.remove(texture)
    else:
        texture.set("filename", str(path))
