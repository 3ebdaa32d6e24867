# SPDX-License-Identifier: Apache-2.0
"""Unread parts of URDF files: elements and attributes beyond those of URDF that Newton's importer reads.

Simulators and tools extend URDF, most often by friction of contacts, and names are misspelt. Newton's importer passes
both over in silence.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

__all__ = ["unread_rows"]


class _Schema(NamedTuple):
    """Attributes and children of an element that are read, or have no meaning for a simulation."""

    attributes: tuple[str, ...] = ()
    children: tuple[str, ...] = ()


_PART = ("origin", "geometry", "material")
_SCHEMA = {
    "robot": _Schema(("name", "version"), ("link", "joint", "material")),
    "link": _Schema(("name",), ("inertial", "visual", "collision")),
    "inertial": _Schema((), ("origin", "mass", "inertia")),
    "origin": _Schema(("xyz", "rpy")),
    "mass": _Schema(("value",)),
    "inertia": _Schema(("ixx", "iyy", "izz", "ixy", "ixz", "iyz")),
    "visual": _Schema(("name",), _PART),
    "collision": _Schema(("name",), _PART),
    "geometry": _Schema(("name",), ("box", "sphere", "cylinder", "capsule", "mesh")),
    "box": _Schema(("name", "size")),
    "sphere": _Schema(("name", "radius")),
    "cylinder": _Schema(("name", "radius", "length")),
    "capsule": _Schema(("name", "radius", "length", "height")),
    "mesh": _Schema(("name", "filename", "scale")),
    "material": _Schema(("name",), ("color", "texture", "specular")),
    "color": _Schema(("rgba",)),
    "specular": _Schema(("rgb", "rgba")),
    "texture": _Schema(("filename",)),
    "joint": _Schema(("name", "type"), ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")),
    "parent": _Schema(("link",)),
    "child": _Schema(("link",)),
    "axis": _Schema(("xyz",)),
    "limit": _Schema(("lower", "upper", "effort", "velocity")),
    "dynamics": _Schema(("damping", "friction")),
    "mimic": _Schema(("joint", "multiplier", "offset")),
}
_MATERIAL = "contacts have the friction and restitution of SimulationCfg.physics_material"
_RIGID = "not read: this package simulates rigid bodies"
_WHY = {
    "contact": _MATERIAL,
    "contact_coefficients": _MATERIAL,
    "surface": _MATERIAL,
    "deformable": _RIGID,
    "reduced_deformable": _RIGID,
    "fem": _RIGID,
    "loop_joint": "not read: the loop stays open",
}


def unread_rows(robot: Element, known: Collection[str], custom: Collection[str]) -> Iterator[tuple[str, str, str]]:
    """Rows ``(element, what, why)`` of what a URDF file has beyond the elements and attributes that are read.

    Args:
        robot: The root element.
        known: Elements for which there are rows already.
        custom: Attributes of links, joints and geometries that Newton reads besides those of URDF.
    """
    yield from _unread(robot, robot.get("name") or "robot", known, custom)


def _unread(
    element: Element, owner: str, known: Collection[str], custom: Collection[str]
) -> Iterator[tuple[str, str, str]]:
    schema = _SCHEMA[element.tag]
    for name in element.attrib:
        # Names of other namespaces are there for other programs.
        if name not in schema.attributes and name not in custom and not name.startswith("{"):
            yield owner, f"{name} of <{element.tag}>", "not read: URDF has no such attribute"
    for child in element:
        tag = child.tag.rpartition("}")[2]
        name = child.get("name") or owner if tag in ("link", "joint", "material") else owner
        if tag in schema.children:
            yield from _unread(child, name, known, custom) if child.tag == tag else ()
        elif tag not in known:
            yield name, f"<{tag}>", _WHY.get(tag, "not read: URDF has no such element")
