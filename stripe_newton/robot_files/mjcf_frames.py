# SPDX-License-Identifier: Apache-2.0
"""MJCF frames: bodies and joints below a ``<frame>`` become those of the body that the frame is in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from xml.etree.ElementTree import Element

import mujoco

__all__ = ["empty_frames"]

_JOINTS = ("joint", "freejoint")
_ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
_Found = tuple[Element, Element, list[Element]]
"""An element, the body or world that it is in, and the frames between the two."""


def empty_frames(root: Element, model: mujoco.MjModel) -> list[Element]:
    """Move bodies and joints out of frames, with poses, anchors and axes in the frame of their body.

    Newton's importer passes over joints in frames, and reads bodies in frames after all others of their body, so that
    the order of bodies is not MuJoCo's. Geoms and sites stay.

    Args:
        root: The file, with what it includes.
        model: MuJoCo's model of it, whose bodies and joints are in the order of the file.

    Returns:
        The elements that were moved.
    """
    worlds = root.findall("worldbody")
    bodies = [found for world in worlds for found in _bodies_below(world)]
    joints = [found for body, _, _ in bodies for found in _inside(body, body, [], _JOINTS)]
    if len(bodies) != model.nbody - 1 or len(joints) != model.njnt:  # copies, which Newton does not read at all
        return []
    moved = []
    for number, (joint, parent, frames) in enumerate(joints):
        if frames:
            moved.append(_lift(joint, parent, frames, "class"))
            if joint.tag == "joint":
                joint.set("pos", _text(model.jnt_pos[number]))
                joint.set("axis", _text(model.jnt_axis[number]))
    for number, (body, parent, frames) in enumerate(bodies, start=1):
        if frames:
            moved.append(_lift(body, parent, frames, "childclass"))
            for name in _ORIENTATIONS:
                body.attrib.pop(name, None)
            body.set("pos", _text(model.body_pos[number]))
            body.set("quat", _text(model.body_quat[number]))
    return moved


def _bodies_below(element: Element) -> Iterator[_Found]:
    """All bodies below an element, in the order of MuJoCo's."""
    for found in _inside(element, element, [], ("body",)):
        yield found
        yield from _bodies_below(found[0])


def _inside(element: Element, parent: Element, frames: list[Element], tags: Iterable[str]) -> Iterator[_Found]:
    """Elements of some tags right below an element, or in its frames."""
    for child in element:
        if child.tag in tags:
            yield child, parent, frames
        elif child.tag == "frame":
            yield from _inside(child, parent, [*frames, child], tags)


def _lift(element: Element, parent: Element, frames: list[Element], class_attribute: str) -> Element:
    """Move an element from the innermost frame to before the outermost one, which keeps the order."""
    frames[-1].remove(element)
    parent.insert(list(parent).index(frames[0]), element)
    classes = [name for frame in frames if (name := frame.get("childclass"))]
    if classes and class_attribute not in element.attrib:
        element.set(class_attribute, classes[-1])
    return element


def _text(values: Iterable[float]) -> str:
    return " ".join(f"{float(value):.12g}" for value in values)
