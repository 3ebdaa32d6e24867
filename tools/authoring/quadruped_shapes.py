# SPDX-License-Identifier: Apache-2.0
"""Surfaces of the quadruped that ``author_quadruped.py`` writes: rounded shells made of superelliptic rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["PARTS", "Part", "Surface"]


@dataclass
class Surface:
    """A smooth surface: points [m] and normals of shape ``(n, 3)``, faces of three or four indices, all outward."""

    points: np.ndarray
    normals: np.ndarray
    faces: list[tuple[int, ...]]


@dataclass
class Part:
    """A surface and the name of its material."""

    name: str
    surface: Surface
    material: str


def loft(axis: str, rings: np.ndarray, sides: int = 32, columns: tuple[int, int] | None = None) -> Surface:
    """A tube through rings, closed by a point at each end.

    A ring is the superellipse ``|u / a|^p + |v / b|^p = 1`` about its centre, in the plane across ``axis``.

    Args:
        axis: ``"x"``, ``"y"`` or ``"z"``: the direction of the tube. (u, v) are the next two axes of x, y, z, x, y.
        rings: Rows ``(position along the axis, centre u, centre v, a, b, p)``, the positions rising.
        sides: Points a ring.
        columns: Keep the faces between these two columns of points alone; column 0 is at +u, the next towards +v.
    """
    at, centre_u, centre_v, a, b, power = np.asarray(rings, dtype=float).T[:, :, None]
    angle = 2.0 * np.pi * np.arange(sides) / sides
    c, s = np.cos(angle), np.sin(angle)
    u = centre_u + a * np.sign(c) * np.abs(c) ** (2.0 / power)
    v = centre_v + b * np.sign(s) * np.abs(s) ** (2.0 / power)
    first = "xyz".index(axis)
    order = [(first + k) % 3 for k in range(3)]
    grid = np.empty((len(rings), sides, 3))
    for k, values in zip(order, (np.broadcast_to(at, u.shape), u, v)):
        grid[:, :, k] = values
    poles = grid[[0, -1]].mean(axis=1)
    points = np.concatenate([grid.reshape(-1, 3), poles])
    start, end, last = len(points) - 2, len(points) - 1, (len(rings) - 1) * sides
    strips = []
    for j in range(sides):
        k = (j + 1) % sides
        strip: list[tuple[int, ...]] = [(start, k, j), (end, last + j, last + k)]
        for i in range(0, last, sides):
            strip.append((i + j, i + k, i + sides + k, i + sides + j))
        strips.append(strip)
    normals = _normals(points, [f for strip in strips for f in strip])
    chosen = range(sides) if columns is None else [j % sides for j in range(columns[0], columns[1])]
    return _compact(points, normals, [f for j in chosen for f in strips[j]])


def _normals(points: np.ndarray, faces: list[tuple[int, ...]]) -> np.ndarray:
    """Unit normals of the points: those of the faces around each, weighted by area."""
    normals = np.zeros_like(points)
    for face in faces:
        p = points[list(face)]
        area = np.cross(p[2] - p[0], p[-1] - p[1]) if len(face) == 4 else np.cross(p[1] - p[0], p[2] - p[0])
        normals[list(face)] += area
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _compact(points: np.ndarray, normals: np.ndarray, faces: list[tuple[int, ...]]) -> Surface:
    """Drop the points that no face uses."""
    used = sorted({i for face in faces for i in face})
    new = {old: i for i, old in enumerate(used)}
    return Surface(points[used], normals[used], [tuple(new[i] for i in face) for face in faces])


def puck(axis: str, low: float, high: float, radius: float, centre: tuple[float, float] = (0.0, 0.0), fillet=0.006):
    """A disc with rounded edges, from ``low`` to ``high`` along ``axis``."""
    turn = np.linspace(0.0, 0.5 * np.pi, 4)
    fillet = min(fillet, 0.49 * (high - low))
    rise, inset = fillet * (1.0 - np.cos(turn)), fillet * (1.0 - np.sin(turn))
    at = [low, *(low + rise), *(high - rise[::-1]), high]
    size = [radius - 1.6 * fillet, *(radius - inset), *(radius - inset[::-1]), radius - 1.6 * fillet]
    rings = [(x, *centre, r, r, 2.0) for x, r in zip(at, size)]
    return loft(axis, np.array(rings), 28)


def rounded(axis: str, profile: np.ndarray, start: float, end: float, power: float, sides: int = 32, **options):
    """A loft whose ends are rounded over the lengths ``start`` and ``end`` [m].

    Args:
        axis: Direction of the tube.
        profile: Rows ``(position, centre u, centre v, half u, half v)``, interpolated between.
        start: Length of the rounding at the low end.
        end: Length of the rounding at the high end.
        power: Exponent of the rings and of the ends.
        sides: Points a ring.
        options: Of :func:`loft`.
    """
    low, high = profile[0, 0], profile[-1, 0]
    turn = np.linspace(0.0, 0.5 * np.pi, 6)[1:]
    at = [*(low + start * (1.0 - np.cos(turn))), *profile[1:-1, 0], *(high - end * (1.0 - np.cos(turn[::-1])))]
    at = np.unique(np.round([x for x in at if low < x < high], 6))
    near = np.clip(np.minimum((at - low) / start, (high - at) / end), 0.0, 1.0)
    shrink = (1.0 - (1.0 - near) ** power) ** (1.0 / power)
    columns = [np.interp(at, profile[:, 0], profile[:, k]) for k in range(1, 5)]
    rings = np.stack([at, *columns[:2], columns[2] * shrink, columns[3] * shrink, np.full_like(at, power)], axis=1)
    return loft(axis, rings, sides, **options)


def smooth(profile: list[tuple[float, ...]], count: int = 25) -> np.ndarray:
    """Rows between the given ones by cubic steps, so that the outline has no corners."""
    rows = np.array(profile)
    at = np.linspace(rows[0, 0], rows[-1, 0], count)
    which = np.clip(np.searchsorted(rows[:, 0], at, side="right") - 1, 0, len(rows) - 2)
    t = (at - rows[which, 0]) / (rows[which + 1, 0] - rows[which, 0])
    t = (t * t * (3.0 - 2.0 * t))[:, None]
    return np.column_stack([at, rows[which, 1:] * (1.0 - t) + rows[which + 1, 1:] * t])


# Rows (x, centre y, centre z, half y, half z) of the trunk.
_TRUNK = [
    (-0.236, 0.0, 0.004, 0.048, 0.046),
    (-0.150, 0.0, 0.002, 0.052, 0.050),
    (-0.095, 0.0, 0.000, 0.072, 0.056),
    (0.095, 0.0, 0.000, 0.072, 0.056),
    (0.150, 0.0, 0.002, 0.052, 0.051),
    (0.236, 0.0, 0.006, 0.048, 0.048),
]


def _trunk() -> list[Part]:
    shell = smooth(_TRUNK, 25)
    split = 2  # columns below the middle that stay light
    upper = rounded("x", shell, 0.035, 0.03, 3.2, columns=(-split, 16 + split))
    lower = rounded("x", shell, 0.035, 0.03, 3.2, columns=(16 + split, 32 - split))
    parts = [Part("shell", upper, "shell"), Part("belly", lower, "graphite")]
    for name, x in (("band_front", 0.112), ("band_rear", -0.112)):
        at = np.linspace(x - 0.006, x + 0.006, 3)
        size = [np.interp(at, shell[:, 0], shell[:, k]) for k in range(1, 5)]
        rings = np.column_stack([at, *size[:2], size[2] + 0.0012, size[3] + 0.0012, np.full(len(at), 3.2)])
        parts.append(Part(name, loft("x", rings), "accent"))
    deck = [(-0.135, 0.0, 0.054, 0.030, 0.008), (0.0, 0.0, 0.055, 0.034, 0.009), (0.135, 0.0, 0.054, 0.030, 0.008)]
    parts.append(Part("deck", rounded("x", smooth(deck, 9), 0.03, 0.03, 3.0), "graphite"))
    tail = [(-0.2435, 0.0, 0.004, 0.035, 0.033), (-0.205, 0.0, 0.004, 0.040, 0.038)]
    parts.append(Part("tail", rounded("x", smooth(tail, 4), 0.008, 0.004, 3.2), "graphite"))
    lamp = [(-0.2455, 0.0, 0.016, 0.022, 0.0028), (-0.232, 0.0, 0.016, 0.022, 0.0028)]
    parts.append(Part("lamp", rounded("x", smooth(lamp, 3), 0.003, 0.003, 3.0, 16), "accent"))
    for end in (1, -1):
        for side in (1, -1):
            low, high = sorted((end * 0.146, end * 0.214))
            name = f"{'F' if end > 0 else 'R'}{'L' if side > 0 else 'R'}_motor"
            parts.append(Part(name, puck("x", low, high, 0.044, (side * 0.0465, 0.0), 0.008), "graphite"))
    return parts + _head()


def _head() -> list[Part]:
    skull = [(0.200, 0.0, 0.010, 0.042, 0.044), (0.255, 0.0, 0.014, 0.050, 0.046), (0.338, 0.0, 0.006, 0.043, 0.036)]
    visor = [(0.300, 0.0, 0.016, 0.040, 0.017), (0.343, 0.0, 0.012, 0.036, 0.014)]
    jaw = [(0.228, 0.0, -0.030, 0.034, 0.022), (0.318, 0.0, -0.030, 0.032, 0.022)]
    light = [(0.318, 0.0, -0.014, 0.030, 0.0035), (0.3405, 0.0, -0.014, 0.027, 0.0030)]
    return [
        Part("skull", rounded("x", smooth(skull, 11), 0.02, 0.030, 3.0), "shell"),
        Part("visor", rounded("x", smooth(visor, 4), 0.01, 0.012, 3.0), "glass"),
        Part("jaw", rounded("x", smooth(jaw, 4), 0.02, 0.020, 2.6, 24), "graphite"),
        Part("light", rounded("x", smooth(light, 3), 0.004, 0.004, 3.0, 16), "light"),
        Part("lidar", puck("z", -0.076, -0.040, 0.030, (0.286, 0.0), 0.014), "glass"),
    ]


def _hip() -> list[Part]:
    """The left hip; turned about z by half a turn it is the right one. The same holds for the thigh."""
    arm = [(0.000, 0.0, 0.0, 0.034, 0.034), (0.030, 0.0, 0.0, 0.036, 0.036), (0.062, 0.0, 0.0, 0.041, 0.041)]
    return [
        Part("arm", rounded("y", smooth(arm, 7), 0.012, 0.004, 2.6, 28), "graphite"),
        Part("motor", puck("y", 0.050, 0.076, 0.0455), "shell"),
    ]


def _thigh() -> list[Part]:
    blade = [  # z, centre x, centre y, half x, half y
        (-0.226, 0.0, 0.0, 0.0205, 0.0125),
        (-0.170, 0.0, 0.0, 0.0185, 0.0125),
        (-0.090, 0.0, 0.0, 0.0235, 0.0135),
        (0.030, 0.0, 0.0, 0.0360, 0.0140),
    ]
    return [
        Part("ring", puck("y", -0.0195, -0.0135, 0.0450, fillet=0.002), "accent"),
        Part("motor", puck("y", -0.014, 0.0125, 0.0455, fillet=0.007), "shell"),
        Part("cap", puck("y", 0.004, 0.0165, 0.0270, fillet=0.004), "graphite"),
        Part("blade", rounded("z", smooth(blade, 13), 0.016, 0.02, 3.0, 28), "shell"),
        Part("knee", puck("y", -0.0170, 0.0170, 0.0195, (-0.213, 0.0), 0.004), "graphite"),
    ]


def _calf() -> list[Part]:
    shank = [  # z, centre x, centre y, half x, half y
        (-0.206, 0.000, 0.0, 0.0090, 0.0090),
        (-0.120, 0.0085, 0.0, 0.0105, 0.0100),
        (0.016, 0.000, 0.0, 0.0175, 0.0120),
    ]
    return [Part("shank", rounded("z", smooth(shank, 13), 0.004, 0.016, 2.4, 24), "graphite")]


def _foot() -> list[Part]:
    cuff = [(0.010, -0.001, 0.0, 0.0165, 0.0165), (0.027, 0.002, 0.0, 0.0115, 0.0115)]
    return [Part("cuff", rounded("z", smooth(cuff, 4), 0.004, 0.004, 2.2, 24), "accent")]


PARTS = {"trunk": _trunk(), "hip": _hip(), "thigh": _thigh(), "calf": _calf(), "foot": _foot()}
"""Surfaces by link, in the link's frame."""
