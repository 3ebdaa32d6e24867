# SPDX-License-Identifier: Apache-2.0
"""Stage damage: valid USD stages and robots' files, and random changes of their text and bytes that a seed repeats."""

from __future__ import annotations

import os
import random
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import newton
from pxr import Sdf, Usd

sys.path.insert(0, str(Path(__file__).parent))

from robot_damage import damage_robot, robot_sources

__all__ = ["Case", "damaged_files"]

MAX_TEXT = 60_000
"""Longest stage that is damaged, as text: a larger one takes its time without showing more."""
ASSETS = Path(newton.__file__).parent
TYPES = (
    "string",
    "double",
    "float",
    "int",
    "token",
    "bool",
    "half",
    "float3",
    "quatf",
    "int[]",
    "point3f[]",
    "matrix4d",
)
VALUES = ("nan", "inf", "-inf", "-1", "0", "1e30", "-1e30", "1e-30", "3e38", '"x"', "[]", "(1, 2)", "None")
NAMES = ("Xform", "Cube", "Mesh", "Sphere", "Plane", "PhysicsJoint", "PhysicsFixedJoint", "DistancePhysicsJoint",
         "Camera", "PhysicsScene", "PointInstancer", "Material", "TetMesh", "Nonsense")  # fmt: skip
SCHEMAS = ("PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsArticulationRootAPI", "PhysicsMassAPI",
           "MaterialBindingAPI", "PhysicsMeshCollisionAPI", "PhysicsRigidBodyApi")  # fmt: skip

WORLD = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "World"
{
    def PhysicsScene "physics" { float physics:gravityMagnitude = 981 }
    def Material "rubber" (prepend apiSchemas = ["PhysicsMaterialAPI"]) { float physics:dynamicFriction = 0.9 }
    def Mesh "ground" (prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"])
    {
        point3f[] points = [(-500, 0, -500), (-500, 0, 500), (500, 0, 500), (500, 0, -500)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
    }
    def Xform "arm" (prepend apiSchemas = ["PhysicsArticulationRootAPI"])
    {
        double3 xformOp:translate = (0, 120, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Xform "base" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
        {
            float physics:mass = 3
            float3 physics:diagonalInertia = (200, 300, 250)
            def Cube "box" (prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"])
            {
                double size = 20
                rel material:binding:physics = </World/rubber>
            }
        }
        def Xform "link" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
        {
            double3 xformOp:translate = (50, 0, 0)
            quatf xformOp:orient = (1, 0, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]
            vector3f physics:velocity = (1, 0, 0)
            def Capsule "capsule" (prepend apiSchemas = ["PhysicsCollisionAPI"])
            {
                double radius = 5
                double height = 20
            }
            def Mesh "skin"
            {
                point3f[] points = [(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10)]
                int[] faceVertexCounts = [3, 3, 3, 3]
                int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
                normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)]
                color3f[] primvars:displayColor = [(1, 0, 0)]
            }
        }
        def Xform "tip" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
        {
            double3 xformOp:translate = (90, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
            def Sphere "ball" (prepend apiSchemas = ["PhysicsCollisionAPI"]) { double radius = 8 }
        }
        def PhysicsRevoluteJoint "hinge" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])
        {
            rel physics:body0 = </World/arm/base>
            rel physics:body1 = </World/arm/link>
            point3f physics:localPos0 = (50, 0, 0)
            uniform token physics:axis = "Z"
            float physics:lowerLimit = -60
            float physics:upperLimit = 60
            float drive:angular:physics:stiffness = 5000
            float drive:angular:physics:damping = 500
        }
        def PhysicsJoint "wrist" (
            prepend apiSchemas = ["PhysicsLimitAPI:rotX", "PhysicsDriveAPI:rotX", "PhysicsLimitAPI:transX"]
        )
        {
            rel physics:body0 = </World/arm/link>
            rel physics:body1 = </World/arm/tip>
            point3f physics:localPos0 = (40, 0, 0)
            float limit:rotX:physics:low = -30
            float limit:rotX:physics:high = 30
            float limit:transX:physics:low = -5
            float limit:transX:physics:high = 5
            float drive:rotX:physics:stiffness = 100
        }
    }
}
""".replace("{ ", "{\n").replace(" }", "\n}")


@dataclass
class Case:
    """A damaged file."""

    file: str
    source: str
    damage: str
    outcome: str = ""
    text: str = ""
    seconds: float = 0.0


def sources() -> dict[str, str]:
    """Valid stages as text, by name."""
    found = {"world": WORLD}
    for folder in ("examples/assets", "tests/assets"):
        for path in sorted((ASSETS / folder).rglob("*.usda")):
            layer = Sdf.Layer.FindOrOpen(str(path))
            text = layer.ExportToString()
            if len(text) < MAX_TEXT and not layer.GetCompositionAssetDependencies() and "Deformable" not in text:
                found[path.stem] = text
    return found


def _edit_line(draw: random.Random, text: str, pattern: str, change: Callable[[re.Match[str]], str]) -> str:
    """Change one match of a pattern."""
    matches = list(re.finditer(pattern, text, re.MULTILINE))
    if not matches:
        return text
    match = draw.choice(matches)
    return text[: match.start()] + change(match) + text[match.end() :]


def change_type(draw: random.Random, text: str) -> str:
    """Give an attribute another type, with a value of it or with the old one."""
    values = {
        "string": '"0.2"',
        "token": '"x"',
        "int": "1",
        "bool": "1",
        "float3": "(1, 2, 3)",
        "quatf": "(1, 0, 0, 0)",
    }

    def other(match: re.Match[str]) -> str:
        kind = draw.choice(TYPES)
        value = values.get(kind, match[4]) if draw.random() < 0.8 else match[4]
        return f"{match[1]}{kind} {match[3]} = {value}"

    return _edit_line(draw, text, r"^(\s*(?:uniform )?)([a-z]+[a-z0-9]*(?:\[\])?) ([A-Za-z][\w:]*) = (.+)$", other)


def change_number(draw: random.Random, text: str) -> str:
    """Replace a number: out of range, not finite, or none."""
    number = r"(?<=[=(\[, ])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?=[,)\]\s])"
    return _edit_line(draw, text, number, lambda match: draw.choice(VALUES[:9] if draw.random() < 0.8 else VALUES))


def change_count(draw: random.Random, text: str) -> str:
    """Drop, repeat or change an element of an array."""

    def other(match: re.Match[str]) -> str:
        elements = re.findall(r"\([^)]*\)|[^,\[\]\s]+", match[2])
        if elements:
            at = draw.randrange(len(elements))
            change = draw.choice(("drop", "repeat", "number", "clear"))
            if change == "drop":
                del elements[at]
            elif change == "repeat":
                elements.insert(at, elements[at])
            elif change == "number" and not elements[at].startswith(("(", '"')):
                elements[at] = draw.choice(("-1", "77", "2147483647", "0"))
            else:
                elements = []
        return f"{match[1]}[{', '.join(elements)}]"

    return _edit_line(draw, text, r"(\[\] [\w:]+ = )\[([^\]]*)\]", other)


def change_reference(draw: random.Random, text: str) -> str:
    """Let a relationship name another prim, one that does not exist, or several."""
    paths = re.findall(r"<(/[^>]*)>", text) or ["/World"]
    targets = ("</gone>", f"<{draw.choice(paths)}>", "[]", f"[<{draw.choice(paths)}>, </gone>]", "</>", "None")
    return _edit_line(draw, text, r"= <[^>]*>", lambda match: f"= {draw.choice(targets)}")


def add_reference(draw: random.Random, text: str) -> str:
    """Let a prim refer to a file or a prim: missing, itself, a pipe, a folder, no USD."""
    arcs = ("references = @gone.usda@", "references = @pipe.usda@", "payload = @./@", "references = @noise.bin@",
            "references = </World>", "inherits = </gone>", "references = @/dev/null@")  # fmt: skip
    return _edit_line(
        draw, text, r"^(\s*def \w+ \"\w+\") ?(?=\(?\s*$)(\(?)",
        lambda match: f"{match[1]} (\n{draw.choice(arcs)}\n" + ("" if match[2] else ")"),
    )  # fmt: skip


def change_name(draw: random.Random, text: str) -> str:
    """Change the type of a prim, or one of its schemas."""
    if draw.random() < 0.5:
        return _edit_line(draw, text, r"def \w+ (?=\")", lambda match: f"def {draw.choice(NAMES)} ")
    return _edit_line(draw, text, r"\"Physics\w+API(:\w+)?\"", lambda match: f'"{draw.choice(SCHEMAS)}"')


def change_unit(draw: random.Random, text: str) -> str:
    """Change the units or the up axis of the stage."""
    lines = ("metersPerUnit = 0", "metersPerUnit = -1", "metersPerUnit = nan", "metersPerUnit = 1e30", 'upAxis = "X"',
             "kilogramsPerUnit = 1e-30", "metersPerUnit = 0.0254", "kilogramsPerUnit = inf")  # fmt: skip
    return text.replace("#usda 1.0\n(", f"#usda 1.0\n(\n    {draw.choice(lines)}", 1)


def change_lines(draw: random.Random, text: str) -> str:
    """Delete, repeat or swap lines."""
    lines = text.splitlines()
    one, two = draw.randrange(1, len(lines)), draw.randrange(1, len(lines))
    change = draw.choice(("delete", "repeat", "swap"))
    if change == "delete":
        del lines[one]
    elif change == "repeat":
        lines.insert(one, lines[one])
    else:
        lines[one], lines[two] = lines[two], lines[one]
    return "\n".join(lines) + "\n"


DAMAGES: tuple[Callable[[random.Random, str], str], ...] = (
    change_type, change_number, change_number, change_count, change_reference, add_reference, change_name, change_unit,
    change_lines,
)  # fmt: skip


def change_bytes(draw: random.Random, content: bytes) -> bytes:
    """Flip, insert, delete or cut off bytes."""
    data = bytearray(content)
    for _ in range(draw.choice((1, 1, 4, 32))):
        if not data:  # cut off, and the rest deleted
            break
        at = draw.randrange(len(data))
        change = draw.choice(("flip", "insert", "delete", "cut"))
        if change == "flip":
            data[at] ^= 1 << draw.randrange(8)
        elif change == "insert":
            data.insert(at, draw.randrange(256))
        elif change == "delete":
            del data[at]
        elif draw.random() < 0.2:
            data = data[: max(at, 1)]
    return bytes(data)


def damaged_files(folder: Path, count: int, seed: int) -> list[Case]:
    """Write damaged files to a folder, two of five a robot's. The same seed gives the same files."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "pipe.usda").exists():
        os.mkfifo(folder / "pipe.usda")
    (folder / "noise.bin").write_bytes(bytes(range(256)))
    texts, robots, cases = sources(), robot_sources(), []
    for number in range(count):
        draw = random.Random(f"{seed} {number}")
        source = "world" if draw.random() < 0.4 else draw.choice(sorted(texts))
        if draw.random() < 0.4:
            own = draw.choice(("arm.urdf", "machine.xml"))
            source = own if draw.random() < 0.7 else draw.choice(sorted(robots))
            text, damage = damage_robot(draw, robots[source])
            path = folder / f"{number:05d}{Path(source).suffix}"
            content = text.encode()
            if draw.random() < 0.1:
                content, damage = change_bytes(draw, content), "change_bytes"
            path.write_bytes(content)
            cases.append(Case(str(path), source, damage))
            continue
        if draw.random() < 0.15:
            case = Case("", source, "change_bytes")
            content = _as_crate(folder, texts[source]) if draw.random() < 0.5 else texts[source].encode()
            suffix = ".usdc" if content.startswith(b"PXR-USDC") else ".usda"
            content = change_bytes(draw, content)
        else:
            damages = [draw.choice(DAMAGES) for _ in range(draw.choice((1, 1, 1, 2)))]
            text, suffix = texts[source], ".usda"
            for damage in damages:
                text = damage(draw, text)
            case = Case("", source, " ".join(damage.__name__ for damage in damages))
            content = text.encode()
        path = folder / f"{number:05d}{suffix}"
        path.write_bytes(content)
        case.file = str(path)
        cases.append(case)
    return cases


def _as_crate(folder: Path, text: str) -> bytes:
    """A stage as a binary file."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(text)
    path = folder / "crate.usdc"
    stage.GetRootLayer().Export(str(path))
    return path.read_bytes()
