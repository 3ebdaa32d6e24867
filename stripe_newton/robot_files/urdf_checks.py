# SPDX-License-Identifier: Apache-2.0
"""URDF checks: what a file says that is wrong, and what it says that Newton's importer does not read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from stripe_newton.usd.body_masses import moments_problem

from .numbers import number_problems, numbers_of

__all__ = ["UNREAD", "Row", "massless_links", "part_problems", "undecided_root", "urdf_problems", "urdf_rows"]

Row = tuple[str, str, str]
"""``(element, what, why)``: something that is left out, read differently from what the file says, or changed."""

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "planar")
_MIMICKED = ("revolute", "continuous", "prismatic")
"""Types of joints that others can follow."""
_SIZES = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "height")}
_SHORTEST_AXIS = 1e-9
"""Length below which an axis has no direction, in single precision and for MuJoCo."""
_WORLD = "world"
"""Name of the link that, by ROS's convention, stands for the world: its joints hold the robot."""
_UNREAD = {
    "gazebo": "Gazebo's extensions are not read",
    "transmission": "transmissions are not read; set gains and limits by actuators",
    "ros2_control": "ros2_control is not read; set gains and limits by actuators",
    "sensor": "sensors are added to the scene's config",
    "mujoco": "MuJoCo's extensions are not read",
}
_UNREAD_OF_JOINTS = {
    "safety_controller": "soft limits are set by soft_joint_pos_limit_factor",
    "calibration": "of the real robot's encoders",
}
UNREAD = frozenset((*_UNREAD, *_UNREAD_OF_JOINTS))
"""Elements that :func:`urdf_rows` has rows for."""


def urdf_problems(robot: Element, floating: bool | None) -> Iterator[str]:
    """Everything that keeps a URDF file from being simulated as it is written.

    Args:
        robot: The root element.
        floating: Whether the root link floats, as the config says; None leaves it to the file.

    Yields:
        Each as ``element: what is wrong, what would be right``.
    """
    for kind in ("link", "joint"):
        names = [element.get("name") for element in robot.findall(kind)]
        for name, count in Counter(names).items():
            if not name:
                yield f"{count} <{kind}> without a name; give each a name of its own"
            elif count > 1:
                yield f"{kind} '{name}': there are {count} of this name; give each a name of its own"
    for link in robot.findall("link"):
        yield from (f"link '{link.get('name')}': {p}" for p in _link_problems(link))
    links = {link.get("name") for link in robot.findall("link")}
    joints = {joint.get("name"): joint.get("type") for joint in robot.findall("joint")}
    for joint in robot.findall("joint"):
        yield from (f"joint '{joint.get('name')}': {p}" for p in _joint_problems(joint, links, joints))
    yield from _tree_problems(robot, floating)


def _link_problems(link: Element) -> Iterator[str]:
    inertial = link.find("inertial")
    if inertial is not None:
        yield from _inertial_problems(inertial)
    for part in link.findall("collision"):
        yield from (f"<collision>: {p}" for p in part_problems(part))


def part_problems(part: Element) -> Iterator[str]:
    """Problems of the frame and the shape of a ``<collision>`` or ``<visual>``, but for the files it names."""
    yield from _origin_problems(part)
    yield from _geometry_problems(part.find("geometry"))


def _inertial_problems(inertial: Element) -> Iterator[str]:
    yield from _origin_problems(inertial)
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or mass.get("value") is None:
        yield "<inertial> has no <mass value=...>; give the mass in kg, or take <inertial> out"
    yield from number_problems(mass, "value", least=0.0)
    components = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    wrong = [p for name in components for p in number_problems(inertia, name)]
    yield from wrong
    if inertia is not None and not wrong and (problem := moments_problem(inertia_of(inertia))):
        yield f"<inertia> has {problem}"


def inertia_of(inertia: Element) -> np.ndarray:
    """The inertia tensor that an element spells out, shape ``(3, 3)``; what is left out is 0."""
    xx, yy, zz, xy, xz, yz = (numbers_of(inertia, n, "0")[0] for n in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _origin_problems(element: Element) -> Iterator[str]:
    for name in ("xyz", "rpy"):
        yield from number_problems(element.find("origin"), name, 3)


def _geometry_problems(geometry: Element | None) -> Iterator[str]:
    shapes = [] if geometry is None else list(geometry)
    if len(shapes) != 1:
        yield f"has {len(shapes)} shapes in its <geometry>, must have one"
        return
    shape = shapes[0]
    if shape.tag == "mesh":
        if not shape.get("filename"):
            yield "<mesh> has no filename"
        yield from number_problems(shape, "scale", 3)
        if (scale := numbers_of(shape, "scale")) and not all(scale):
            yield f"scale of <mesh> is '{shape.get('scale')}', must not be 0"
    elif shape.tag not in _SIZES:
        yield f"<{shape.tag}> is no shape of URDF; use {', '.join((*_SIZES, 'mesh'))}"
    else:
        for name in _SIZES[shape.tag]:
            if shape.get(name) is None:
                yield f"<{shape.tag}> has no {name}"
                continue
            wrong = list(number_problems(shape, name, 3 if name == "size" else 1))
            yield from wrong
            if not wrong and min(numbers_of(shape, name)) <= 0.0:
                yield f"{name} of <{shape.tag}> is {shape.get(name)}, must be positive"


def _joint_problems(joint: Element, links: set[str | None], joints: dict[str | None, str | None]) -> Iterator[str]:
    kind = joint.get("type")
    if kind == "floating":
        yield (
            "is of type 'floating', which only a root link can do: take the joint and the link above it out, and set "
            "fix_base=False"
        )
    elif kind not in _JOINT_TYPES:
        yield (f"is of type '{kind}'" if kind else "has no type") + f", must be {', '.join(_JOINT_TYPES)}"
    for end in ("parent", "child"):
        element = joint.find(end)
        name = None if element is None else element.get("link")
        if name is None:
            yield f"has no <{end} link=...>"
        elif name not in links:
            advice = f'; add <link name="{_WORLD}"/>, which some simulators do by themselves' if name == _WORLD else ""
            yield f"its {end} '{name}' is no link of the file{advice}"
    yield from _origin_problems(joint)
    axis, limit = joint.find("axis"), joint.find("limit")
    yield from number_problems(axis, "xyz", 3)
    if kind != "fixed" and (values := numbers_of(axis, "xyz")) and all(abs(v) < _SHORTEST_AXIS for v in values):
        yield f"its axis is {' '.join(f'{v:g}' for v in values)}, must have a direction"
    for name in ("lower", "upper"):
        yield from number_problems(limit, name, infinite=True)
    for name in ("effort", "velocity"):
        yield from number_problems(limit, name, least=0.0, infinite=True)
    low, high = numbers_of(limit, "lower"), numbers_of(limit, "upper")
    if low and high and low[0] > high[0]:
        yield f"its lower limit {low[0]:g} is above its upper limit {high[0]:g}; exchange them"
    for name in ("damping", "friction"):
        yield from number_problems(joint.find("dynamics"), name, least=0.0)
    if (mimic := joint.find("mimic")) is not None:
        yield from _mimic_problems(mimic, joints)


def _mimic_problems(mimic: Element, joints: dict[str | None, str | None]) -> Iterator[str]:
    followed = mimic.get("joint")
    if followed is None:
        yield "<mimic> has no joint; name the joint that it follows, or take <mimic> out"
    elif followed not in joints:
        yield f"mimics '{followed}', which is no joint of the file"
    elif joints[followed] not in _MIMICKED:
        yield (
            f"mimics '{followed}', a {joints[followed]} joint; it can follow one that is {', '.join(_MIMICKED)}: "
            "take <mimic> out"
        )
    for name in ("multiplier", "offset"):
        yield from number_problems(mimic, name)


def _tree_problems(robot: Element, floating: bool | None) -> Iterator[str]:
    """Whether the joints make one tree of the links, and whether it is said that its root floats."""
    parents = _joints_above(robot)
    for link, above in parents.items():
        if len(above) > 1:
            yield f"link '{link}': is the child of joints {_quoted(above)}, must be that of one: URDF has no loops"
    roots = _roots(robot)
    if len(roots) > 1:
        yield f"links {_quoted(roots)} are the child of no joint: one must be the root, and joints lead to the others"
    elif not roots and not parents:
        yield "has no link"
    elif not roots and not _missing_parents(robot):
        yield "has no root link: its joints form a loop"
    elif roots and floating is None and (root := undecided_root(robot)):
        yield (
            f"the file does not say whether its root link '{root}' floats, as it has no link '{_WORLD}' that holds "
            "it; set fix_base=False, or fix_base=True to hold it in the world"
        )


def undecided_root(robot: Element) -> str:
    """Root link of which the file does not say whether it floats; empty if it says so, or has no or several roots."""
    roots = _roots(robot)
    return roots[0] if len(roots) == 1 and roots[0] != _WORLD else ""


def _roots(robot: Element) -> list[str]:
    parents = _joints_above(robot)
    return [name for link in robot.findall("link") if (name := link.get("name", "")) not in parents]


def _missing_parents(robot: Element) -> set[str]:
    """Links that joints name as their parent and that the file does not have: each of these joints says so."""
    named = {parent.get("link", "") for joint in robot.findall("joint") for parent in joint.findall("parent")}
    return named - {link.get("name", "") for link in robot.findall("link")}


def _joints_above(robot: Element) -> dict[str, list[str]]:
    """Names of the joints that have a link as their child, by its name."""
    found: dict[str, list[str]] = {}
    for joint in robot.findall("joint"):
        for child in joint.findall("child"):
            found.setdefault(child.get("link", ""), []).append(joint.get("name", ""))
    return found


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def urdf_rows(robot: Element) -> Iterator[Row]:
    """Rows of what Newton's importer leaves out of a URDF file, or reads differently."""
    for tag, why in _UNREAD.items():
        if elements := robot.findall(tag):
            yield f"robot ({len(elements)})", f"<{tag}>", why
    for joint in robot.findall("joint"):
        yield from ((joint.get("name", ""), what, why) for what, why in _joint_rows(joint))
    massless = set(massless_links(robot))
    for link in robot.findall("link"):
        if link.find("inertial") is None and link.find("collision") is not None:
            if link.get("name") in massless:
                why = "it has no mass, as URDF says, and moves with a link that has"
            else:
                why = "its mass is that of its colliders at the builder's density"
            yield link.get("name", ""), "no <inertial>", why


def massless_links(robot: Element) -> Iterator[str]:
    """Links that have colliders and no ``<inertial>``, and are fixed to a link that has a mass.

    A link without ``<inertial>`` has no mass. Where nothing that it is fixed to has one either it could not move, and
    gets the mass of its colliders, as in other simulators.
    """
    group = {link.get("name", ""): link.get("name", "") for link in robot.findall("link")}

    def top(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    for joint in robot.findall("joint"):
        ends = [getattr(joint.find(tag), "attrib", {}).get("link", "") for tag in ("parent", "child")]
        if joint.get("type") == "fixed" and all(end in group for end in ends):
            group[top(ends[1])] = top(ends[0])
    heavy = {
        top(link.get("name", ""))
        for link in robot.findall("link")
        if any(mass > 0.0 for mass in numbers_of(link.find("inertial/mass"), "value"))
    }
    for link in robot.findall("link"):
        name = link.get("name", "")
        if link.find("inertial") is None and link.find("collision") is not None and top(name) in heavy:
            yield name


def _joint_rows(joint: Element) -> Iterator[tuple[str, str]]:
    kind, limit = joint.get("type"), joint.find("limit")
    for tag, why in _UNREAD_OF_JOINTS.items():
        if joint.find(tag) is not None:
            yield f"<{tag}>", why
    if kind in ("revolute", "prismatic") and not (numbers_of(limit, "lower") and numbers_of(limit, "upper")):
        yield "no limits", f"URDF wants lower and upper of a {kind} joint; those that are missing are none"
    if kind in ("revolute", "prismatic", "continuous") and numbers_of(limit, "effort") == [0.0]:
        yield "effort limit 0", "its drive can do nothing until an actuator sets effort_limit"
    if kind == "continuous" and (numbers_of(limit, "lower") or numbers_of(limit, "upper")):
        yield "limits", "a continuous joint turns without end; they are left out"
    if kind == "fixed" and joint.find("mimic") is not None:
        yield "<mimic>", "left out: a fixed joint does not move"
    if kind == "planar":
        yield "planar joint", "it slides along two axes and does not turn"
    if (
        kind != "fixed"
        and (axis := numbers_of(joint.find("axis"), "xyz"))
        and abs(float(np.linalg.norm(axis)) - 1.0) > 1e-3
    ):
        yield "axis", f"its length is {float(np.linalg.norm(axis)):.3g}; it is taken as 1"
