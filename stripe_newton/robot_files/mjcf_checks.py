# SPDX-License-Identifier: Apache-2.0
"""MJCF checks: what a file says that is wrong, as MuJoCo's compiler and a look at its numbers find it."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco

from stripe_newton.input_files import why_no_file
from stripe_newton.usd.git_lfs import POINTER_REASON, is_pointer

from .error import RobotFileError
from .numbers import MAX_NUMBER, numbers_of

__all__ = ["compile_mjcf"]

_TEXT = {
    "name", "class", "childclass", "dclass", "mesh", "material", "texture", "file", "joint", "joint1", "joint2", "body",
    "body1", "body2", "site", "site1", "site2", "target", "tendon", "geom", "geom1", "geom2", "hfield", "actuator",
    "objname", "refname", "refsite", "data", "prefix", "model", "sidesite", "cranksite", "slidersite", "jointinparent",
}  # fmt: skip
"""Attributes that hold names, which may be called ``nan``."""
_MAY_BE_INFINITE = {
    "range", "ctrlrange", "forcerange", "actuatorfrcrange", "actrange", "lengthrange", "user", "inheritrange",
}  # fmt: skip
"""Attributes without an end: ranges. Stiffness, damping, velocities, gravity and all else must be finite."""
_RANGES = {"range", "ctrlrange", "forcerange", "actuatorfrcrange", "actrange"}
"""Attributes with a least and a greatest value; ``limited`` and the like say whether they hold."""
_FILES = {"file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback"}
"""Attributes that name files."""
_ASSET_FOLDERS = ("meshdir", "texturedir", "assetdir")
"""Attributes of ``<compiler>`` that name the folders of such files."""
_NOT_READ = {
    "replicate": "copies of a body",
    "attach": "parts of other models",
    "composite": "composite bodies",
    "flexcomp": "deformable bodies",
    "flex": "deformable bodies",
}
"""Elements below ``<worldbody>`` and ``<deformable>`` that Newton's importer passes over."""


def compile_mjcf(path: Path, for_newton: bool = True) -> mujoco.MjModel:
    """The model that MuJoCo makes of a file, which Newton's is compared with.

    Args:
        path: The file.
        for_newton: Whether Newton's importer is to read the file, too.

    Raises:
        RobotFileError: MuJoCo refuses the file, its numbers are not finite, or it has bodies that Newton does not read.
    """
    problems: list[str] = []
    roots = [root for _, root in _documents(path, problems)]
    problems += _asset_problems(path, roots)
    for root in roots:
        problems += [*_number_problems(root), *_range_problems(root)]
        if for_newton:
            problems += [*_unread_problems(root), *_ball_problems(root)]
    if problems:
        raise RobotFileError(path, problems)
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        text = " ".join(str(error).replace("XML Error: ", "").replace("Error: ", "").split())
        raise RobotFileError(path, [f"MuJoCo refuses it: {text}"]) from error


def _documents(path: Path, problems: list[str]) -> Iterator[tuple[Path, Element]]:
    """A file and all that it includes."""
    waiting, seen = [path], set[Path]()
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        if problem := why_no_file(file):
            problems.append(f"<include>: '{file}' {problem}")
            continue
        try:
            root = ElementTree.parse(file).getroot()
        except (ElementTree.ParseError, UnicodeDecodeError) as error:
            problems.append(f"'{file}' is not well-formed XML: {error}")
            continue
        yield file, root
        waiting += [path.parent / name for include in root.iter("include") if (name := include.get("file"))]


def _asset_problems(path: Path, roots: list[Element]) -> Iterator[str]:
    """Files of assets that MuJoCo would wait for or read without end, and pointers of git LFS."""
    compilers = [compiler for root in roots for compiler in root.iter("compiler")]
    folders = dict.fromkeys(["", *(c.get(name, "") for c in compilers for name in _ASSET_FOLDERS)])
    for element in (e for root in roots for e in root.iter() if e.tag != "include"):
        for name in (n for key, n in element.attrib.items() if key in _FILES and n):
            for file in (path.parent / folder / name for folder in folders):
                if os.path.exists(file) and (problem := _file_problem(file)):
                    yield f"<{element.tag}> '{element.get('name') or file.stem}': '{file}' {problem}"
                    break


def _file_problem(file: Path) -> str:
    """Why a file that is there is not read; empty if it is."""
    return why_no_file(file) or (POINTER_REASON if is_pointer(file) else "")


def _number_problems(root: Element) -> Iterator[str]:
    for parent, element in _with_parents(root):
        for attribute, text in element.attrib.items():
            if attribute in _TEXT:
                continue
            try:
                values = [float(word) for word in text.split()]
            except ValueError:
                continue  # a word, or something that MuJoCo will refuse
            if any(math.isnan(v) for v in values):
                yield f"{_named(element, parent)}: {attribute} is not a number ({text}), must be finite"
            elif attribute not in _MAY_BE_INFINITE and any(math.isinf(v) for v in values):
                yield f"{_named(element, parent)}: {attribute} is infinite ({text}), must be finite"
            elif attribute not in _MAY_BE_INFINITE and any(abs(v) > MAX_NUMBER for v in values):
                yield f"{_named(element, parent)}: {attribute} is {text}, must be at most {MAX_NUMBER:g}"


def _range_problems(root: Element) -> Iterator[str]:
    """Ranges the wrong way round, which MuJoCo takes for none where the element does not say that it is limited."""
    for parent, element in _with_parents(root):
        for attribute in _RANGES & element.attrib.keys():
            limited = element.get(f"{attribute.removesuffix('range')}limited", "auto")
            values = numbers_of(element, attribute)
            if limited != "false" and len(values) == 2 and values[0] > values[1]:
                low, high = values
                yield f"{_named(element, parent)}: {attribute} is {low:g} {high:g}, the wrong way round; exchange them"


def _unread_problems(root: Element) -> Iterator[str]:
    for parent, element in _with_parents(root):
        if element.tag in _NOT_READ:
            yield (
                f"{_named(element, parent)}: Newton's importer does not read {_NOT_READ[element.tag]} (<{element.tag}>)"
                + (
                    "; write the file out with mujoco.MjSpec.from_file(path), compile() and to_xml()"
                    if element.tag in ("replicate", "attach")
                    else "; this package simulates rigid bodies, take it out"
                )
            )


def _ball_problems(root: Element) -> Iterator[str]:
    """Bodies with a ball joint and others: Newton merges the joints of a body into one, which cannot have both."""
    for body in root.iter("body"):
        joints = body.findall("joint")
        if len(joints) > 1 and any(joint.get("type") == "ball" for joint in joints):
            yield (
                f"<body> '{body.get('name', '')}': has a ball joint and {len(joints) - 1} more, which Newton's "
                "importer cannot merge; use a freejoint, or give each joint a body of its own"
            )


def _with_parents(root: Element) -> Iterator[tuple[Element, Element]]:
    for parent in root.iter():
        for child in parent:
            yield parent, child


def _named(element: Element, parent: Element) -> str:
    """How messages call an element: by its name, or by what it belongs to."""
    for attribute in ("name", "joint", "file"):
        if name := element.get(attribute):
            return f"<{element.tag}> '{name}'"
    owner = parent.get("name") or parent.get("class")
    return f"<{element.tag}>" + (f" of <{parent.tag}> '{owner}'" if owner else f" of <{parent.tag}>")
