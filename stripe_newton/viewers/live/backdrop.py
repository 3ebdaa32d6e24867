# SPDX-License-Identifier: Apache-2.0
"""Backdrop: sky, sun and ground of the live view, with the colours of the pictures and videos."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stripe_newton.viewers.lighting import Lighting, lighting_from
from stripe_newton.viewers.poses import wxyz

from .glb_file import glb_of
from .view_frame import VIEW, ViewFrame

if TYPE_CHECKING:
    import viser

    from stripe_newton.usd import Light

__all__ = ["Backdrop"]

_SKY_RADIUS = 600.0
"""Radius of the sky [m], within what browsers draw."""
_FADE = 0.3, 0.95
"""Shares of the ground's radius at which it begins and ends to fade into the horizon."""
_SQUARES = 8
"""Squares along a side of the ground's picture."""
_PIXELS = 64
"""Side of a square in the picture [px]."""
_SATURATION = 1.35
_TONES = 0.52, 0.565, 0.68
"""Brightness of dark and light squares and of the joints, sRGB."""
_AT_REST = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])


class Backdrop:
    """Sky, sun and ground around a scene.

    Args:
        server: The web server that shows them.
        lights: Lights of the scene; they give the sun's direction and the tint of the sky.
        radius: Size of what is shown [m], from which that of the ground's squares follows.
        azimuth: Direction of the camera, about +Z from +X [rad]; a sun that the scene lacks shines from its left.
    """

    def __init__(self, server: viser.ViserServer, lights: Sequence[Light], radius: float, azimuth: float):
        self._server, self._grounds = server, list[tuple["viser.BatchedGlbHandle", float]]()
        self._square = next(side for limit, side in ((0.3, 0.1), (1.0, 0.25), (8.0, 1.0), (60.0, 5.0), (np.inf, 25.0))
                            if radius <= limit)  # fmt: skip
        self._reach = max(60.0, 40.0 * min(radius, 5.0))
        lighting = lighting_from(lights, azimuth)
        scene = server.scene
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(enabled=False)
        sun = lighting.sun / max(float(lighting.sun.max()), 1e-6)
        place = tuple(float(x) for x in 30.0 * lighting.to_sun)
        scene.add_light_directional("/sun", color=_bytes(sun), intensity=2.6, cast_shadow=True, position=place)
        sky, ground = (value / max(float(lighting.sky.max()), 1e-6) for value in (lighting.sky, lighting.ground))
        scene.add_light_hemisphere("/skylight", sky_color=_bytes(sky), ground_color=_bytes(ground), intensity=1.6)
        vertices, faces, colors = _dome(lighting)
        dome = glb_of(vertices, faces, colors=colors, unlit=True)
        scene.add_glb("/sky", dome, cast_shadow=False, receive_shadow=False)

    def set_grounds(self, planes: Sequence[np.ndarray]) -> None:
        """Draw level grounds at the heights of some endless planes, poses ``(7,)`` in the world frame."""
        for handle, _ in self._grounds:
            handle.remove()
        self._grounds = []
        heights = sorted({round(float(pose[2]), 4) for pose in planes})
        for index, height in enumerate(heights):
            disc = _ground(self._reach, self._square)
            # One instance, so that a browser moves it together with the robots on it.
            handle = self._server.scene.add_batched_glb(
                f"{VIEW}/ground_{index}", disc, _AT_REST[:, [6, 3, 4, 5]], _AT_REST[:, :3],
                lod="off", cast_shadow=False, receive_shadow=True,
            )  # fmt: skip
            self._grounds.append((handle, height))

    def update(self, frame: ViewFrame) -> None:
        """Move the ground to where the camera is, by whole periods of its pattern so that it seems to stand still.

        Args:
            frame: Where the world is in the scene.
        """
        period = self._square * _SQUARES
        pose = _AT_REST.copy()
        pose[0, :2] = np.round(frame.center[:2] / period) * period
        for handle, height in self._grounds:
            pose[0, 2] = height
            placed = frame.poses(pose)
            handle.batched_positions, handle.batched_wxyzs = placed[:, :3].astype(np.float32), wxyz(placed[:, 3:])


def _bytes(color: np.ndarray) -> tuple[int, int, int]:
    """A colour from 0 to 1 as bytes."""
    r, g, b = (round(255.0 * float(x)) for x in np.clip(color, 0.0, 1.0))
    return r, g, b


def _dome(lighting: Lighting) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sky: a sphere seen from inside, the horizon's colour below, towards that of the zenith above."""
    rings = np.radians(np.concatenate([[-90.0, -20.0, -3.0], np.linspace(0.0, 90.0, 31)]))
    turns = np.linspace(0.0, 2.0 * np.pi, 49)
    height, turn = (grid.reshape(-1) for grid in np.meshgrid(rings, turns, indexing="ij"))
    directions = np.stack([np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.sin(height)], axis=1)
    share = np.clip(np.sin(height), 0.0, 1.0)[:, None] ** 0.55
    colors = lighting.horizon * (1.0 - share) + lighting.zenith * share
    glow = np.clip(directions @ lighting.to_sun, 0.0, 1.0)[:, None]
    # Browsers compress bright colours towards grey, so the sky is given more colour than it shall have.
    grey = colors.mean(axis=1, keepdims=True)
    colors = np.clip(grey + _SATURATION * (colors - grey), 0.0, None)
    colors = colors + 0.10 * glow**8 * np.array([1.0, 0.95, 0.85])
    return _SKY_RADIUS * directions, _grid(len(rings), len(turns)), np.column_stack([colors, np.ones(len(colors))])


def _ground(reach: float, square: float) -> bytes:
    """A level disc with squares that fades at its edge, as a GLB file."""
    radii = np.concatenate([[0.0], np.geomspace(0.02, 1.0, 40)]) * reach
    turns = np.linspace(0.0, 2.0 * np.pi, 73)
    radius, turn = (grid.reshape(-1) for grid in np.meshgrid(radii, turns, indexing="ij"))
    vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(len(turn))], axis=1)
    begin, end = (share * reach for share in _FADE)
    alpha = 1.0 - np.clip((radius - begin) / (end - begin), 0.0, 1.0)
    colors = np.column_stack([np.ones((len(turn), 3)), alpha * alpha * (3.0 - 2.0 * alpha)])
    uvs = vertices[:, :2] / (square * _SQUARES)
    faces = _grid(len(radii), len(turns))
    return glb_of(vertices, faces, colors=colors, uvs=uvs, picture=_squares(), transparent=True)


def _squares() -> np.ndarray:
    """Squares in two tones with light joints, sRGB uint8; it repeats without a seam."""
    side = _SQUARES * _PIXELS
    row, column = np.indices((side, side))
    dark = (row // _PIXELS + column // _PIXELS) % 2 == 0
    tone = np.where(dark, _TONES[0], _TONES[1])
    joint = (row % _PIXELS < 1) | (column % _PIXELS < 1)
    tone = np.where(joint, _TONES[2], tone)[..., None] * np.array([0.97, 0.99, 1.02])
    return np.round(255.0 * np.clip(tone, 0.0, 1.0)).astype(np.uint8)


def _grid(rows: int, columns: int) -> np.ndarray:
    """Two triangles for each cell of a grid of vertices in C order, counterclockwise along (row, column)."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.reshape(-1) for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
