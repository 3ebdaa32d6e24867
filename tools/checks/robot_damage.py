# SPDX-License-Identifier: Apache-2.0
"""Robot damage: valid URDF and MJCF files, and random changes of their text that a seed repeats."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

import newton

__all__ = ["damage_robot", "robot_sources"]

MAX_TEXT = 40_000
"""Longest file that is damaged."""
NUMBERS = ("nan", "inf", "-inf", "-1", "0", "1e30", "-1e30", "1e-30", "3e38", "x", "", "1 2", "1 2 3 4 5")
MJCF_TAGS = ("body", "geom", "joint", "freejoint", "inertial", "site", "camera", "motor", "position", "tendon", "weld",
             "default", "frame", "include", "nonsense")  # fmt: skip
URDF_TAGS = ("link", "joint", "inertial", "collision", "visual", "limit", "mimic", "transmission", "nonsense")
WORDS = ("free", "ball", "slide", "hinge", "mesh", "plane", "hfield", "sdf", "floating", "continuous", "planar",
         "fixed",         "true", "auto", "gone", "")  # fmt: skip

ARM = """<robot name="arm">
<link name="base"><inertial><mass value="3"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.1" rpy="0 0 0"/><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
<link name="upper"><inertial><origin xyz="0 0 .2"/><mass value="1"/>
<inertia ixx=".02" iyy=".02" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>
<visual><geometry><sphere radius="0.1"/></geometry><material name="m"><color rgba="1 0 0 1"/></material></visual></link>
<link name="lower"><inertial><mass value="0.5"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<link name="tool"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 .3"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="50" velocity="3"/>
<dynamics damping="0.5" friction="0.1"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/>
<limit effort="20" velocity="3"/></joint>
<joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/></joint>
</robot>
"""
MACHINE = """<mujoco model="machine">
<compiler angle="degree" autolimits="true"/>
<option timestep="0.002" integrator="implicitfast"/>
<default><geom friction="0.8 0.01 0.001" condim="3"/><default class="leg"><joint damping="1" armature="0.01"/></default>
</default>
<asset><mesh name="tetra" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/></asset>
<worldbody>
<geom name="floor" type="plane" size="5 5 .1"/>
<body name="base" pos="0 0 0.6">
<freejoint name="root"/>
<geom type="box" size="0.2 0.1 0.05" mass="3"/>
<body name="thigh" pos="0.2 0 0" childclass="leg">
<joint name="hip" axis="0 1 0" range="-60 60" ref="10"/>
<joint name="roll" axis="1 0 0" range="-20 20"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03"/>
<body name="shin" pos="0 0 -0.2"><joint name="knee" axis="0 1 0" range="-120 0" stiffness="2" springref="-20"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/><geom type="mesh" mesh="tetra"/>
<site name="foot" pos="0 0 -.2"/>
</body></body>
<body name="wheel" pos="-0.2 0 0"><joint name="spin" axis="0 1 0"/><geom type="cylinder" size="0.1 0.02"/></body>
</body>
</worldbody>
<contact><exclude body1="base" body2="shin"/></contact>
<equality><joint joint1="spin" joint2="knee" polycoef="0 1 0 0 0"/></equality>
<tendon><fixed name="t"><joint joint="knee" coef="1"/><joint joint="spin" coef="-1"/></fixed></tendon>
<actuator><position name="p" joint="hip" kp="30" forcerange="-20 20"/><motor joint="knee" gear="5" ctrlrange="-1 1"/>
</actuator>
<sensor><jointpos joint="knee"/></sensor>
<keyframe><key name="home" qpos="0 0 0.6 1 0 0 0 0 0 -0.5 0"/></keyframe>
</mujoco>
"""


def robot_sources() -> dict[str, str]:
    """Valid files as text, by name with their suffix: two of every kind of element, and Newton's without meshes."""
    found = {"arm.urdf": ARM, "machine.xml": MACHINE}
    for path in sorted((Path(newton.__file__).parent / "examples/assets").glob("*")):
        if path.suffix in (".urdf", ".xml"):
            text = path.read_text()
            if len(text) < MAX_TEXT and "filename=" not in text and "file=" not in text:
                found[path.name] = text
    return found


def damage_robot(draw: random.Random, text: str) -> tuple[str, str]:
    """A file with one or two random changes, and their names."""
    chosen = [draw.choice(DAMAGES) for _ in range(draw.choice((1, 1, 1, 2)))]
    for damage in chosen:
        text = damage(draw, text)
    return text, " ".join(damage.__name__ for damage in chosen)


def _edit(draw: random.Random, text: str, pattern: str, change: Callable[[re.Match[str]], str]) -> str:
    matches = list(re.finditer(pattern, text))
    if not matches:
        return text
    match = draw.choice(matches)
    return text[: match.start()] + change(match) + text[match.end() :]


def change_number(draw: random.Random, text: str) -> str:
    """Replace one number of an attribute."""
    return _edit(draw, text, r"(?<=[\"\s])-?\d*\.?\d+(?:e[-+]?\d+)?(?=[\"\s])", lambda _: draw.choice(NUMBERS))


def change_value(draw: random.Random, text: str) -> str:
    """Replace the value of an attribute by a number, a word, or another value of the file."""
    values = re.findall(r"=\"([^\"]*)\"", text)
    return _edit(draw, text, r"=\"[^\"]*\"", lambda _: f'="{draw.choice([*NUMBERS, *WORDS, *values])}"')


def change_attribute(draw: random.Random, text: str) -> str:
    """Delete an attribute, or give it the name of another."""
    names = re.findall(r"\s([a-z_]\w*)=\"", text)
    return _edit(
        draw, text, r"\s([a-z_]\w*)=(\"[^\"]*\")", lambda m: draw.choice(("", f" {draw.choice(names)}={m[2]}"))
    )


def change_tag(draw: random.Random, text: str) -> str:
    """Give an element without children another tag."""
    tags = URDF_TAGS if "<robot" in text else MJCF_TAGS
    return _edit(draw, text, r"<\w+(?=[^<>]*/>)", lambda _: f"<{draw.choice(tags)}")


def change_element(draw: random.Random, text: str) -> str:
    """Delete or repeat an element without children."""
    return _edit(draw, text, r"<\w+[^<>]*/>", lambda match: draw.choice(("", match[0] * 2)))


def move_element(draw: random.Random, text: str) -> str:
    """Put an element without children behind another one."""
    elements = re.findall(r"<\w+[^<>]*/>", text)
    return _edit(draw, text, r"<\w+[^<>]*/>", lambda match: match[0] + draw.choice(elements))


def change_lines(draw: random.Random, text: str) -> str:
    """Delete or swap lines."""
    lines = text.splitlines()
    one, two = draw.randrange(1, len(lines)), draw.randrange(1, len(lines))
    if draw.random() < 0.5:
        del lines[one]
    else:
        lines[one], lines[two] = lines[two], lines[one]
    return "\n".join(lines) + "\n"


DAMAGES: tuple[Callable[[random.Random, str], str], ...] = (
    change_number, change_number, change_value, change_attribute, change_tag, change_element, move_element,
    change_lines,
)  # fmt: skip
