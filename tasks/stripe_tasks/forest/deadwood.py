# SPDX-License-Identifier: Apache-2.0
"""Deadwood: meshes of stumps, fallen trunks and branches. A generator in the same state gives the same mesh.

A fallen trunk and a branch lie along their own x, their axis at z = 0: ``placement.lie_on_slope`` gives their poses.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from stripe_newton.specifications import Collider, DynamicMesh

from .stones import capsule_between, check_positive, face_normals, reach_on_ground, split_faces, tinted, tube

__all__ = ["branch", "fallen_trunk", "stump"]

Body = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Vertices, faces, and the kind of each face."""

_SUNK = 0.15  # depth of a stump below the ground [m]
_STUMP_SIDES = 18
_BARKS = ((0.125, 0.092, 0.066), (0.165, 0.145, 0.122), (0.105, 0.083, 0.07))
_WOOD = (0.40, 0.275, 0.145)
_ROTTEN = (0.20, 0.125, 0.07)
_MOSS = (0.070, 0.092, 0.024)
_EARTH = (0.105, 0.072, 0.047)


def stump(name: str, radius: float, height: float, rng: np.random.Generator) -> DynamicMesh:
    """Make the stump of a tree, sawn or broken off, with spreading roots; it reaches 0.15 m below the ground.

    Its collider is an upright capsule that ends at the top.

    Args:
        name: An identifier.
        radius: Of the trunk above its roots [m].
        height: Of its highest point above the ground [m].
        rng: Generator of all random numbers.

    Raises:
        ValueError: If a size is not positive.
    """
    check_positive("stump", radius=radius, height=height)
    sawn = bool(rng.random() < 0.55)
    sides = _STUMP_SIDES
    flare = min(0.9 * radius, 0.5 * height)  # height of the roots' flare
    wide, heights, crown = _stump_rings(radius, height, flare, sawn, rng)
    rings = len(wide)
    turn = 2.0 * math.pi * np.arange(sides) / sides
    # only the faces of the tube are used: its vertices lie on rings of one height each, those of a stump do not
    _, faces = tube(np.stack([0 * wide[:, 0], 0 * wide[:, 0], np.arange(rings)], axis=1), wide[:, 0], sides)
    grid = np.stack([wide * np.cos(turn), wide * np.sin(turn), heights], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([grid, [[0.0, 0.0, -_SUNK], [0.0, 0.0, crown]]])
    vertices[:, 2] += np.where(vertices[:, 2] > flare, height - vertices[:, 2].max(), 0.0)
    kind = _stump_kinds(vertices, faces, rings, height, rng)
    bark = tinted(_BARKS[rng.integers(len(_BARKS))], rng)
    wood = tinted(_WOOD if sawn else _ROTTEN, rng)
    parts = split_faces(vertices, faces, kind, [("bark", bark), ("wood", wood), ("moss", tinted(_MOSS, rng))])
    return DynamicMesh(
        name, parts, [_stump_collider(vertices, rings, radius, height, sawn)], "stump", reach_on_ground(parts)
    )


def _stump_rings(
    radius: float, height: float, flare: float, sawn: bool, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Radii and heights of a stump's rings, ``(8, sides)`` [m] from below the ground up; height of its middle."""
    sides = _STUMP_SIDES
    turn = 2.0 * math.pi * np.arange(sides) / sides
    # four to six roots, each a bump of the outline about its heading
    roots = int(rng.integers(4, 7))
    heading = 2.0 * math.pi * (np.arange(roots) + rng.uniform(-0.25, 0.25, roots)) / roots
    apart = np.abs((turn[:, None] - heading[None] + math.pi) % (2.0 * math.pi) - math.pi)
    spread = (rng.uniform(0.55, 1.1, roots) * np.exp(-((apart / 0.30) ** 2))).max(axis=1)
    # heights of the rings: below the ground, on it, over the roots, on the trunk, the rim
    levels = np.array([-_SUNK, 0.0, 0.25 * flare, flare, 0.5 * (flare + height), height])
    rise = np.clip(levels / flare, 0.0, 1.0)
    shape = 1.0 + (1.0 - rise[:, None]) ** 2 * (0.10 + spread) + 0.0 * turn
    shape[0] *= 1.12
    # furrows run along the trunk, so they are the same in all rings, but for some noise
    furrow = 1.0 + rng.uniform(-0.07, 0.07, sides)
    shape *= furrow * (1.0 + rng.uniform(-0.03, 0.03, shape.shape))
    # rim: tilted and nearly even where it was sawn, splintered on one side where it broke
    if sawn:
        tilt = rng.uniform(0.0, 0.12)
        rim = -0.16 * radius - tilt * radius * (1.0 + np.cos(turn - rng.uniform(0.0, 6.3)))
        rim += rng.uniform(-0.02, 0.02, sides) * radius
    else:
        split = np.cos(turn - rng.uniform(0.0, 6.3))
        rim = -(0.55 - 0.45 * split) * min(radius, 0.5 * height) * rng.uniform(0.4, 1.4, sides)
    wall_top = height + rim
    heights = levels[:, None] + 0.0 * turn
    heights[-1] = wall_top
    heights[-2] = 0.5 * (heights[-3] + wall_top)
    wide = radius * shape * np.linspace(1.0, 0.94, len(levels))[:, None]
    # the top: the bark's edge, then the wood, domed where it was sawn, hollow where it broke
    inner = 0.86 * wide[-1]
    depth = np.abs(rim).max()
    if sawn:
        top, crown = wall_top + 0.03 * radius, height
    else:
        top, crown = wall_top - rng.uniform(0.05, 0.35, sides) * depth, height - 1.1 * depth
    return np.vstack([wide, inner, 0.45 * inner]), np.vstack([heights, top, 0.55 * crown + 0.45 * top]), float(crown)


def _stump_kinds(
    vertices: np.ndarray, faces: np.ndarray, rings: int, height: float, rng: np.random.Generator
) -> np.ndarray:
    """Kind of each face of a stump: 0 for bark, 1 for wood at the top, 2 for moss on one side."""
    sides = _STUMP_SIDES
    ring = np.where(faces < rings * sides, faces // sides, np.where(faces == rings * sides, 0, rings)).min(axis=1)
    normal = face_normals(vertices, faces)
    kind = np.where(ring >= rings - 2, 1, 0)
    # moss on one side and on what faces up, in the lower part
    mossy = rng.random() < 0.6
    north = rng.uniform(0.0, 2.0 * math.pi)
    facing = normal[:, 0] * np.cos(north) + normal[:, 1] * np.sin(north)
    middle = vertices[faces].mean(axis=1)[:, 2]
    return np.where(mossy & (kind == 0) & (facing + 0.7 * normal[:, 2] > 0.72) & (middle < 0.6 * height), 2, kind)


def _stump_collider(vertices: np.ndarray, rings: int, radius: float, height: float, sawn: bool) -> Collider:
    """Upright capsule as wide as the trunk above the roots, whose cap ends near the top."""
    sides = _STUMP_SIDES
    top = float(np.quantile(vertices[(rings - 3) * sides : rings * sides, 2], 0.75)) + (0.10 if sawn else 0.05) * radius
    top = min(top, height + 0.05 * radius)
    trunk = vertices[2 * sides : (rings - 2) * sides]
    fitted = float(np.median(np.hypot(trunk[:, 0], trunk[:, 1])))
    high = top - fitted
    low = min(-_SUNK + fitted, high - 0.1 * fitted)
    return capsule_between((0.0, 0.0, low), (0.0, 0.0, high), fitted)


def fallen_trunk(
    name: str, length: float, radius: float, rng: np.random.Generator, root_plate: bool | None = None
) -> DynamicMesh:
    """Make a trunk that lies along its x axis, broken at its ends, with stubs of branches.

    Its colliders are one capsule, or two in a row where it bends or tapers much, and one for the root plate.

    Args:
        name: An identifier.
        length: From end to end [m].
        radius: Mean radius [m].
        rng: Generator of all random numbers.
        root_plate: Whether the thick end, at negative x, has its roots; by chance where None.

    Raises:
        ValueError: If a size is not positive, or it is shorter than it is thick.
    """
    check_positive("fallen_trunk", length=length, radius=radius)
    _check_longer("fallen_trunk", length, radius)
    chance = bool(rng.random() < 0.3)
    plate = chance if root_plate is None else root_plate
    # rings about four radii apart; one more close to each end, where the break begins
    rings, sides = int(np.clip(length / (4.0 * radius), 4, 10)) + 2, 12
    x = np.linspace(-0.5, 0.5, rings)
    x[1], x[-2] = x[0] + 0.6 * radius / length, x[-1] - 0.6 * radius / length
    # bent to one side, about its own mean, so that the middle line stays on the x axis
    bow = rng.uniform(-1.0, 1.0) * min(0.02 * length, 0.9 * radius)
    line = np.stack([x * length, bow * (1.0 / 3.0 - 4.0 * x**2), 0.0 * x], axis=1)
    taper = min(0.014 * length / radius / 2.0, 0.28)
    radii = radius * (1.0 - 2.0 * taper * x)
    shape = 1.0 + rng.uniform(-0.06, 0.06, (1, sides)) + rng.uniform(-0.035, 0.035, (rings, sides))
    shape[[0, -1]] *= rng.uniform(0.84, 0.96, (2, sides))
    along = _broken_ends(rings, sides, radii, radius, rng)
    vertices, faces = tube(line, radii, sides, shape=shape, along=along)
    vertices[-2, 0] += 0.1 * radius
    vertices[-1, 0] -= 0.1 * radius
    wall = 2 * (rings - 1) * sides
    normal = face_normals(vertices, faces)
    middle = vertices[faces].mean(axis=1)
    # moss on top, in patches along the trunk
    patches = np.sin(middle[:, 0] * rng.uniform(1.5, 3.0) + rng.uniform(0.0, 6.3))
    kind = np.where(np.arange(len(faces)) >= wall, 1, 0)
    mossy = (rng.random() < 0.65) & (kind == 0) & (normal[:, 2] > 0.62 - 0.3 * patches)
    kind = np.where(mossy, 2, kind)
    bodies = [(vertices, faces, kind)]
    bodies += _branch_stubs(line, length, radius, rng)
    colliders = _along(vertices[: rings * sides].reshape(rings, sides, 3), line, length)
    if plate:
        body, held = _root_plate(-0.5 * length, radii[0], rng)
        bodies.append(body)
        colliders.append(held)
    bark = tinted(_BARKS[rng.integers(len(_BARKS))], rng)
    colors = [("bark", bark), ("wood", tinted(_ROTTEN if rng.random() < 0.5 else _WOOD, rng))]
    colors += [("moss", tinted(_MOSS, rng)), ("earth", tinted(_EARTH, rng))]
    parts = split_faces(*_together(bodies), colors)
    return DynamicMesh(name, parts, colliders, "log", reach_on_ground(parts, -math.inf))


def _broken_ends(rings: int, sides: int, radii: np.ndarray, radius: float, rng: np.random.Generator) -> np.ndarray:
    """Shift of each corner of a trunk along its axis [m], ``(rings, sides)``: ragged at both ends."""
    along = np.zeros((rings, sides))
    along[0] = rng.uniform(0.0, 0.75, sides) * radii[0]
    along[-1] = -rng.uniform(0.0, 0.9, sides) * radii[-1]
    along[0] -= along[0].min()
    along[-1] -= along[-1].max()
    # the rings beside the ends give way, or the surface would fold over itself
    along[1] = np.maximum(along[0] - 0.45 * radius, 0.0)
    along[-2] = np.minimum(along[-1] + 0.45 * radius, 0.0)
    return along


def _branch_stubs(line: np.ndarray, length: float, radius: float, rng: np.random.Generator) -> list[Body]:
    """Two to five stubs of branches on a fallen trunk, sideways or up."""
    bodies = []
    for _ in range(int(rng.integers(2, 6))):
        at = float(rng.uniform(-0.3, 0.44)) * length
        thick = radius * float(rng.uniform(0.16, 0.3))
        rise = float(rng.uniform(0.0, math.pi))  # sideways or up
        lean = float(rng.uniform(0.1, 0.7))
        out = np.array([lean, math.cos(rise), math.sin(rise)]) / math.sqrt(1.0 + lean**2)
        root = np.array([at, np.interp(at, line[:, 0], line[:, 1]), 0.0])
        reach = radius * float(rng.uniform(1.5, 3.2))
        steps = np.array([0.4 * radius, radius + 0.3 * (reach - radius), reach])
        bodies.append(_stub(root + steps[:, None] * out, thick * np.array([1.25, 0.95, 0.6]), rng))
    return bodies


def branch(name: str, length: float, radius: float, rng: np.random.Generator) -> DynamicMesh:
    """Make a crooked branch that lies along its x axis, with one to three twigs; its collider is a capsule.

    Args:
        name: An identifier.
        length: From end to end [m], such as 1 to 3.
        radius: At its thick end [m], such as 0.015 to 0.05.
        rng: Generator of all random numbers.

    Raises:
        ValueError: If a size is not positive, or it is shorter than it is thick.
    """
    check_positive("branch", length=length, radius=radius)
    _check_longer("branch", length, radius)
    joints, sides = 8, 6
    x = np.linspace(-0.5, 0.5, joints)
    x[1:-1] += rng.uniform(-0.03, 0.03, joints - 2)
    # a random walk to the side and some waviness upwards, less the straight line through them
    crook = np.cumsum(rng.normal(0.0, 1.0, (joints, 2)), axis=0) * (0.018 * length, 0.0)
    crook[:, 1] = rng.uniform(-0.4, 0.4, joints) * radius
    crook -= np.stack([np.polyval(np.polyfit(x, c, 1), x) for c in crook.T], axis=1)
    line = np.column_stack([x * length, crook])
    radii = radius * np.linspace(1.0, 0.45, joints)
    shape = 1.0 + rng.uniform(-0.1, 0.1, (joints, sides))
    vertices, faces = tube(line, radii, sides, shape=shape)
    # end to end it is as long as asked for, closed ends included
    vertices[:, 0] *= length / np.ptp(vertices[:, 0])
    vertices[:, 0] -= 0.5 * (vertices[:, 0].min() + vertices[:, 0].max())
    kind = np.where(np.arange(len(faces)) >= 2 * (joints - 1) * sides, 1, 0)
    bodies = [(vertices, faces, kind)]
    # twigs stand out to alternating sides of the thin part
    side = float(rng.choice([-1.0, 1.0]))
    for twig in range(int(rng.integers(1, 4))):
        at = float(rng.uniform(-0.1, 0.3))
        root = np.array([np.interp(at, x, line[:, k]) for k in range(3)])
        thick = 0.6 * float(np.interp(at, x, radii))
        reach = length * float(rng.uniform(0.13, 0.26))
        turn = side * (-1.0) ** twig * float(rng.uniform(0.5, 0.95))
        rise = float(rng.uniform(0.05, 0.5))
        out = np.array([math.cos(turn) * math.cos(rise), math.sin(turn) * math.cos(rise), math.sin(rise)])
        steps = np.array([0.0, 0.45, 1.0])[:, None] * reach * out
        steps[1:] += rng.normal(0.0, 0.06 * reach, (2, 3)) * (0.5, 1.0, 0.3)
        bodies.append(_stub(root + steps, thick * np.array([1.0, 0.75, 0.35]), rng))
    parts = split_faces(
        *_together(bodies),
        [("bark", tinted(_BARKS[rng.integers(len(_BARKS))], rng)), ("wood", tinted(_WOOD, rng))],
    )
    rings = vertices[: joints * sides].reshape(joints, sides, 3)
    return DynamicMesh(name, parts, _along(rings, line, length, 1), "deadwood", reach_on_ground(parts, -math.inf))


def _check_longer(function: str, length: float, radius: float) -> None:
    """Raise a ValueError if a trunk or branch is too short for its radius."""
    if length <= 4.0 * radius:
        raise ValueError(f"{function}: length is {length:g}, must be more than 4 times its radius, {4.0 * radius:g} m")


def _stub(line: np.ndarray, radii: np.ndarray, rng: np.random.Generator) -> Body:
    """A thin closed tube with a broken end; kind 0 is its bark, 1 the wood of its end."""
    n, sides = len(line), 5
    along = np.zeros((n, sides))
    along[-1] = rng.uniform(-0.8, 0.8, sides) * radii[-1]
    vertices, faces = tube(line, radii, sides, shape=1.0 + rng.uniform(-0.1, 0.1, (n, sides)), along=along)
    return vertices, faces, np.where(np.arange(len(faces)) >= len(faces) - sides, 1, 0)


def _root_plate(x: float, radius: float, rng: np.random.Generator) -> tuple[Body, Collider]:
    """Torn roots and earth around the end of a trunk: a lens across x, with spikes; its collider lies along y."""
    # every second corner is a root that stands out, between them earth has broken off
    sides = 14
    reach = 2.4 * radius * rng.uniform(0.8, 1.2, sides)
    rim = reach * np.where(np.arange(sides) % 2 == 0, 1.12, 0.85)
    step = np.array([-0.55, -0.5, -0.2, 0.15, 0.75]) * radius
    share = np.array([0.35, 0.75, 1.0, 0.72, 0.4])
    shape = share[:, None] * rim * (1.0 + rng.uniform(-0.08, 0.08, (len(step), sides))) / radius
    along = rng.uniform(-0.13, 0.13, shape.shape) * radius
    line = np.stack([x + step, 0.0 * step, 0.0 * step], axis=1)
    vertices, faces = tube(line, np.full(len(step), radius), sides, shape=shape, along=along)
    held = 0.5 * radius
    half = 1.15 * radius
    lift = 0.85 * radius
    collider = capsule_between((x - 0.05 * radius, -half, lift), (x - 0.05 * radius, half, lift), held)
    return (vertices, faces, np.full(len(faces), 3)), collider


def _along(rings: np.ndarray, line: np.ndarray, length: float, most: int = 2) -> list[Collider]:
    """Capsules along a trunk: one, or up to ``most`` in a row where one is off by an eighth of its radius."""
    apart = np.linalg.norm(rings - rings.mean(axis=1, keepdims=True), axis=2)[1:-1]
    x, middle = line[:, 0], rings.mean(axis=1)
    for count in range(1, most + 1):
        found, errors = [], []
        edges = np.linspace(-0.5, 0.5, count + 1) * length
        for low, high in itertools.pairwise(edges):
            mine = (x[1:-1] >= low - 1.0e-9) & (x[1:-1] <= high + 1.0e-9)
            radius = float(apart[mine].mean())
            y, z = (np.polyfit(middle[1:-1][mine, 0], middle[1:-1][mine, k], 1) for k in (1, 2))
            ends = []
            for edge, outer in ((low, low == edges[0]), (high, high == edges[-1])):
                at = edge - math.copysign(radius, edge) if outer else edge
                ends.append((float(at), float(np.polyval(y, at)), float(np.polyval(z, at))))
            found.append(capsule_between(ends[0], ends[1], radius))
            ring = rings[1:-1][mine]
            away = np.hypot(ring[..., 1] - np.polyval(y, ring[..., 0]), ring[..., 2] - np.polyval(z, ring[..., 0]))
            errors.append(np.abs(away - radius).mean() / radius)
        if max(errors) < 0.125:
            break
    return found


def _together(bodies: list[Body]) -> Body:
    """Join several bodies into one."""
    offset = np.cumsum([0] + [len(b[0]) for b in bodies[:-1]])
    vertices, faces, kinds = zip(*bodies, strict=True)
    moved = [f + o for f, o in zip(faces, offset, strict=True)]
    return np.concatenate(vertices), np.concatenate(moved), np.concatenate(kinds)
