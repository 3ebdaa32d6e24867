# SPDX-License-Identifier: Apache-2.0
"""URDF files: what Newton's importer would decide without a word."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

__all__ = ["check_root"]

_WORLD = "world"
"""Name of the link that, by ROS's convention, stands for the world: its joints hold the robot."""


def check_root(path: str | Path, floating: bool | None) -> None:
    """Check that a URDF file has one root link, and that it is known whether the world holds it.

    Args:
        path: The file.
        floating: Whether its root link floats, as the config says; None leaves it to the file.

    Raises:
        ValueError: with what is wrong, and what would be right.
    """
    try:
        robot = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError, UnicodeDecodeError):
        return  # the importer's to tell
    children = {child.get("link") for joint in robot.findall("joint") for child in joint.findall("child")}
    roots = [name for link in robot.findall("link") if (name := link.get("name")) not in children]
    if len(roots) > 1:
        names = ", ".join(f"'{name}'" for name in roots)
        raise ValueError(
            f"links {names} are the child of no joint: one must be the root, and joints lead to the others"
        )
    for joint in robot.findall("joint"):
        if joint.get("type") == "floating":
            raise ValueError(
                f"joint '{joint.get('name')}' is of type 'floating', which only a root link can do: take the joint and "
                "the link above it out, and set fix_base=False"
            )
    if floating is None and roots and roots[0] != _WORLD:
        raise ValueError(
            f"the file does not say whether its root link '{roots[0]}' floats, as it has no link '{_WORLD}' that holds "
            "it; set fix_base=False, or fix_base=True to hold it in the world"
        )
