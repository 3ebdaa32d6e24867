# SPDX-License-Identifier: Apache-2.0
"""Author a furnished flat of two storeys: ``python tools/authoring/author_flat.py FILE [--bodies] [--stairs]``.

FILE is a USD file, such as ``flat.usda``. A living room of full height with a table that a small robot can walk under,
a bedroom behind a door, and a gallery above it, which stairs lead up to. Walls and stairs are one concave mesh each, as
files of buildings have them; furniture is made of boxes and cylinders. With ``--bodies`` there is a ball and a carton
that move, with ``--stairs`` mounds of stairs beside it, to train robots on. Lengths are in metres, z is up;
``docs/importing_a_world.md`` shows it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSemantics, UsdShade, Vt

__all__ = ["GALLERY", "RISE", "STEPS", "TREAD", "author_flat"]

Box = tuple[float, float, float, float, float, float]
"""Lower corner, upper corner [m]."""

WIDTH, DEPTH, WALL, STOREY = 11.0, 7.0, 0.12, 2.6
"""Extent along x and y, thickness of the walls, height of the rooms [m]."""
GALLERY, EDGE = 2.8, 1.0
"""Height of the gallery, and x of its edge [m]."""
STEPS, RISE, TREAD = 20, 0.14, 0.3
"""Steps of the stairs, the last of which is the gallery itself, their height and depth [m]."""

MOUNDS, MOUND_STEPS, MOUND_TOP, MOUND_PITCH, MOUND_RISES = 5, 5, 2.0, 7.0, (0.04, 0.16)
"""Mounds along an axis, steps of one, width of its top, distance of two, least and greatest height of a step [m]."""

WHITE, OAK, PINE, GREY = (0.82, 0.80, 0.76), (0.42, 0.27, 0.14), (0.62, 0.46, 0.28), (0.33, 0.35, 0.38)
BLUE, GREEN, RED = (0.10, 0.20, 0.36), (0.10, 0.28, 0.12), (0.50, 0.10, 0.07)


def author_flat(path: str | Path, bodies: bool = False, stairs: bool = False) -> Path:
    """Write the flat to a USD file.

    Args:
        path: The file.
        bodies: Whether a ball and a carton that move are in it.
        stairs: Whether there are mounds of stairs beside it.
    """
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Flat").GetPrim())
    _lights(stage)
    _shell(stage)
    _ground_floor(stage)
    _gallery(stage)
    if bodies:
        _bodies(stage)
    if stairs:
        _mounds(stage)
    _bind_material(stage)
    stage.GetRootLayer().Export(str(path))
    return Path(path)


# -- rooms


def _shell(stage: Usd.Stage) -> None:
    """Floors, walls, stairs."""
    x, y = 0.5 * WIDTH, 0.5 * DEPTH
    _boxes(stage, "/Flat/floor", [(-x, -y, -0.2, x, y, 0.0)], PINE, "floor")
    _boxes(stage, "/Flat/gallery", [(EDGE, -y, STOREY, x, y, GALLERY)], PINE, "floor")
    top = GALLERY + 1.1
    walls: list[Box] = [
        (-x - WALL, -y, 0.0, -x, y, STOREY),  # west
        (x, -y, 0.0, x + WALL, y, top),  # east, beside the gallery too
        (-x - WALL, y, 0.0, x + WALL, y + WALL, top),  # north
        # south: a long window with a sill, posts and a lintel
        (-x - WALL, -y - WALL, 0.0, EDGE, -y, 0.7),
        (-x - WALL, -y - WALL, 2.2, EDGE, -y, STOREY),
        (-x - WALL, -y - WALL, 0.7, -x + 0.3, -y, 2.2),
        (-2.1, -y - WALL, 0.7, -1.9, -y, 2.2),
        (EDGE, -y - WALL, 0.0, x + WALL, -y, top),
        # between living room and bedroom, with a door of 1 m by 2.1 m
        (EDGE, -y, 0.0, EDGE + WALL, -1.2, STOREY),
        (EDGE, -0.2, 0.0, EDGE + WALL, y, STOREY),
        (EDGE, -1.2, 2.1, EDGE + WALL, -0.2, STOREY),
    ]
    _mesh(stage, "/Flat/walls", walls, WHITE, "wall")
    first = EDGE - TREAD * (STEPS - 1)
    steps: list[Box] = [(first + TREAD * i, y - 1.15, 0.0, EDGE, y, RISE * (i + 1)) for i in range(STEPS - 1)]
    _mesh(stage, "/Flat/stairs", steps, OAK, "stairs")


def _ground_floor(stage: Usd.Stage) -> None:
    """Furniture of living room and bedroom."""
    _table(stage, "/Flat/table", (-2.6, -1.1), (1.9, 1.0, 0.76))
    for i, (x, y, back) in enumerate(((-3.1, -1.95, -1), (-2.1, -1.95, -1), (-3.1, -0.25, 1), (-2.1, -0.25, 1))):
        _chair(stage, f"/Flat/chair_{i + 1}", (x, y), back)
    sofa: list[Box] = [(-5.45, -0.4, 0.1, -4.6, 1.6, 0.42), (-5.45, -0.4, 0.42, -5.2, 1.6, 0.85)]
    _boxes(stage, "/Flat/sofa", [*sofa, (-5.45, -0.6, 0.1, -4.6, -0.4, 0.62)], BLUE, "sofa")
    _boxes(stage, "/Flat/rug", [(-3.9, 0.1, 0.0, -2.4, 1.5, 0.01)], RED, "rug")
    _boxes(stage, "/Flat/shelf", [(0.6, -3.4, 0.0, EDGE, -1.6, 1.9)], OAK, "shelf")
    _cylinder(stage, "/Flat/lamp/foot", (-5.1, -2.9, 0.015), 0.16, 0.03, GREY)
    _cylinder(stage, "/Flat/lamp/pole", (-5.1, -2.9, 0.8), 0.015, 1.6, GREY)
    _cylinder(stage, "/Flat/plant/pot", (0.2, 1.4, 0.2), 0.2, 0.4, RED)
    _sphere(stage, "/Flat/plant/leaves", (0.2, 1.4, 0.75), 0.38, GREEN)
    bed: list[Box] = [(3.5, 0.9, 0.0, 5.5, 2.5, 0.45), (5.35, 0.9, 0.45, 5.5, 2.5, 0.95)]
    _boxes(stage, "/Flat/bed", bed, BLUE, "bed")
    _boxes(stage, "/Flat/wardrobe", [(2.4, -3.5, 0.0, 4.6, -2.9, 2.1)], OAK, "wardrobe")


def _gallery(stage: Usd.Stage) -> None:
    """Railing and furniture of the gallery."""
    posts: list[Box] = [
        (EDGE, y - 0.02, GALLERY, EDGE + 0.04, y + 0.02, GALLERY + 0.9) for y in np.arange(-3.4, 2.3, 0.2).tolist()
    ]
    rail: Box = (EDGE, -3.5, GALLERY + 0.9, EDGE + 0.05, 2.3, GALLERY + 0.95)
    _boxes(stage, "/Flat/railing", [*posts, rail], GREY, "railing")
    _table(stage, "/Flat/desk", (4.2, -2.4), (1.4, 0.7, 0.74), GALLERY)
    _boxes(stage, "/Flat/chest", [(5.0, 1.0, GALLERY, 5.5, 2.2, GALLERY + 0.8)], OAK, "chest")


def _mounds(stage: Usd.Stage) -> None:
    """Mounds east of the flat, with stairs on all sides, of which one is steeper than the other."""
    side = MOUNDS * MOUND_PITCH
    west, south = 0.5 * WIDTH + 1.0, -0.5 * side
    _boxes(stage, "/Flat/yard", [(west, south, -0.2, west + side, south + side, 0.0)], PINE, "floor")
    for i in range(MOUNDS**2):
        x, y = west + (i % MOUNDS + 0.5) * MOUND_PITCH, south + (i // MOUNDS + 0.5) * MOUND_PITCH
        rise = MOUND_RISES[0] + i / (MOUNDS**2 - 1) * (MOUND_RISES[1] - MOUND_RISES[0])
        steps: list[Box] = []
        for step in range(MOUND_STEPS):
            half = 0.5 * MOUND_TOP + TREAD * (MOUND_STEPS - 1 - step)
            steps.append((x - half, y - half, 0.0, x + half, y + half, rise * (step + 1)))
        _mesh(stage, f"/Flat/mound_{i + 1}", steps, OAK, "stairs")


def _table(
    stage: Usd.Stage, path: str, at: tuple[float, float], size: tuple[float, float, float], floor: float = 0.0
) -> None:
    (x, y), (length, width, height) = at, size
    a, b, top = 0.5 * length, 0.5 * width, floor + height
    boxes: list[Box] = [(x - a, y - b, top - 0.04, x + a, y + b, top)]
    for i in (-1, 1):
        for j in (-1, 1):
            u, v = x + i * (a - 0.06), y + j * (b - 0.06)
            boxes.append((u - 0.03, v - 0.03, floor, u + 0.03, v + 0.03, top - 0.04))
    _boxes(stage, path, boxes, OAK, "table")


def _chair(stage: Usd.Stage, path: str, at: tuple[float, float], back: int) -> None:
    (x, y), s = at, 0.21
    low, high = sorted((y + back * s, y + back * (s - 0.03)))
    boxes: list[Box] = [(x - s, y - s, 0.43, x + s, y + s, 0.46), (x - s, low, 0.46, x + s, high, 0.9)]
    boxes += [
        (x + i * 0.19 - 0.02, y + j * 0.19 - 0.02, 0.0, x + i * 0.19 + 0.02, y + j * 0.19 + 0.02, 0.43)
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    _boxes(stage, path, boxes, PINE, "chair")


def _bodies(stage: Usd.Stage) -> None:
    """A ball and a carton that move."""
    ball = _sphere(stage, "/Flat/ball", (-0.6, 0.4, 0.11), 0.11, (0.8, 0.75, 0.1))
    (carton,) = _boxes(stage, "/Flat/carton", [(-0.9, -2.9, 0.0, -0.55, -2.5, 0.3)], (0.45, 0.32, 0.2), "carton")
    for prim, mass in ((ball, 0.43), (carton, 1.5)):
        UsdPhysics.RigidBodyAPI.Apply(prim)
        UsdPhysics.MassAPI.Apply(prim).CreateMassAttr(mass)


# -- prims


def _boxes(stage: Usd.Stage, path: str, boxes: Sequence[Box], color: Sequence[float], label: str) -> list[Usd.Prim]:
    """Colliders that are boxes; several are parts of one prim."""
    made = []
    for i, box in enumerate(boxes):
        cube = UsdGeom.Cube.Define(stage, path if len(boxes) == 1 else f"{path}/part_{i + 1}")
        low, high = np.array(box[:3]), np.array(box[3:])
        cube.CreateSizeAttr(1.0)
        cube.AddTranslateOp().Set(Gf.Vec3d(*(0.5 * (low + high)).tolist()))
        cube.AddScaleOp().Set(Gf.Vec3f(*(high - low).tolist()))
        made.append(_finish(cube, color))
    _label(stage.GetPrimAtPath(path), label)
    return made


def _mesh(stage: Usd.Stage, path: str, boxes: Iterable[Box], color: Sequence[float], label: str) -> None:
    """One mesh collider made of boxes."""
    points, faces = [], []
    for box in boxes:
        corners = np.array(
            [[box[3 * i], box[3 * j + 1], box[3 * k + 2]] for k in (0, 1) for j in (0, 1) for i in (0, 1)]
        )
        sides = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
        faces.append(sides + 8 * len(points))
        points.append(corners)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.concatenate(points).astype(np.float32)))
    every = np.concatenate(faces).astype(np.int32)
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(every.reshape(-1)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(every), 4, dtype=np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    # Its triangles collide: a hull would fill the rooms.
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.none)
    _label(_finish(mesh, color), label)


def _cylinder(
    stage: Usd.Stage, path: str, at: Sequence[float], radius: float, height: float, color: Sequence[float]
) -> None:
    cylinder = UsdGeom.Cylinder.Define(stage, path)
    cylinder.CreateRadiusAttr(radius)
    cylinder.CreateHeightAttr(height)
    cylinder.CreateAxisAttr("Z")
    cylinder.AddTranslateOp().Set(Gf.Vec3d(*at))
    _finish(cylinder, color)


def _sphere(stage: Usd.Stage, path: str, at: Sequence[float], radius: float, color: Sequence[float]) -> Usd.Prim:
    sphere = UsdGeom.Sphere.Define(stage, path)
    sphere.CreateRadiusAttr(radius)
    sphere.AddTranslateOp().Set(Gf.Vec3d(*at))
    return _finish(sphere, color)


def _finish(shape: UsdGeom.Gprim, color: Sequence[float]) -> Usd.Prim:
    shape.CreateDisplayColorAttr([Gf.Vec3f(*color)])
    UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
    return shape.GetPrim()


def _label(prim: Usd.Prim, label: str) -> None:
    UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr([label])


def _bind_material(stage: Usd.Stage) -> None:
    """A physics material beside the flat, as files often have it."""
    material = UsdShade.Material.Define(stage, "/Materials/wood")
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    api.CreateDynamicFrictionAttr(0.7)
    api.CreateStaticFrictionAttr(0.7)
    flat = stage.GetPrimAtPath("/Flat")
    UsdShade.MaterialBindingAPI.Apply(flat).Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")


def _lights(stage: Usd.Stage) -> None:
    UsdLux.DomeLight.Define(stage, "/Lights/sky").CreateIntensityAttr(900.0)
    sun = UsdLux.DistantLight.Define(stage, "/Lights/sun")
    sun.CreateIntensityAttr(1800.0)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(-28.0, -22.0, 0.0))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    print(author_flat(sys.argv[1], bodies="--bodies" in sys.argv[2:], stairs="--stairs" in sys.argv[2:]))
