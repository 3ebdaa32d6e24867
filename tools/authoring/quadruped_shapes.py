# SPDX-License-Identifier: Apache-2.0
"""Quadruped shapes: the visible surfaces of each link that ``author_quadruped.py`` writes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lofts import Surface, loft, puck, rounded, smooth

__all__ = ["PARTS", "Part"]


@dataclass
class Part:
    """Surface of a link, and the name of its material."""

    name: str
    surface: Surface
    material: str


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
    """The trunk with its motors, and the head."""
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
    """The left hip; half a turn about z makes it the right one. The same holds for the thigh."""
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
