# SPDX-License-Identifier: Apache-2.0
"""Picture layers: draws the sensors and commands whose ``debug_vis`` is set into pictures and films."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from stripe_newton.sim import ArrowCfg, CylinderCfg, FrameCfg, PreviewSurfaceCfg, SphereCfg
from stripe_newton.sim.spawners.spawner_cfg import SpawnerCfg

from .layers import Drawn, HasSimulation, command_layers, sensor_layers
from .markers import VisualizationMarkers, VisualizationMarkersCfg

if TYPE_CHECKING:
    from .viewed_simulation import ViewedSimulation

__all__ = ["PictureLayers"]

_SHORTEST = 0.05
"""Length below which an arrow is not drawn [m]."""
_FULL = 0.3
"""Length from which on an arrow has its full width [m]."""
_POINT, _LINE, _ARROW = 0.014, 0.004, 0.03
"""Radius of a point and of a line, width of an arrow [m]."""


class PictureLayers:
    """Layers of an environment that its config asks for, as markers that are visible while a picture is made."""

    def __init__(self, env: HasSimulation, env_ids: Sequence[int], chosen: int):
        """Find the layers.

        Args:
            env: The environment.
            env_ids: The environments that pictures show.
            chosen: The one whose sensors are drawn.
        """
        self._env_ids, self._chosen = list(env_ids), chosen

        def make(name: str) -> _MarkerDrawing:
            return _MarkerDrawing(env.sim, name)

        layers = (*command_layers(make, env), *sensor_layers(make, env))
        self._layers: list[Drawn] = [layer for layer in layers if layer.is_asked]

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Context in which a picture shows them: the live view has layers of its own."""
        for layer in self._layers:
            layer.update(self._env_ids, self._chosen)
        try:
            yield
        finally:
            for layer in self._layers:
                layer.set_visible(False)


class _MarkerDrawing:
    """A drawing of markers, which are made when there is first something to draw."""

    def __init__(self, sim: ViewedSimulation, name: str):
        self._sim, self._name = sim, name
        self._markers: VisualizationMarkers | None = None

    def hide(self) -> None:
        """Take it off the scene."""
        if self._markers is not None:
            self._markers.set_visibility(False)

    def arrows(self, starts: np.ndarray, ways: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw arrows."""
        fine = np.isfinite(starts).all(axis=1) & (np.linalg.norm(np.nan_to_num(ways), axis=1) > _SHORTEST)
        starts, ways = starts[fine], ways[fine]
        length = np.linalg.norm(ways, axis=1)
        thick = np.minimum(1.0, length / _FULL)
        scales = np.column_stack([length, thick, thick])
        prototype = ArrowCfg(length=1.0, width=_ARROW, head=0.3, color=_linear(color))
        self._place(prototype, starts, _turns(ways, (1.0, 0.0, 0.0)), scales)

    def points(self, points: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw points."""
        points = points[np.isfinite(points).all(axis=1)]
        material = PreviewSurfaceCfg(diffuse_color=_linear(color))
        self._place(SphereCfg(radius=_POINT, visual_material=material), points, None, None)

    def lines(self, starts: np.ndarray, ends: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw lines."""
        fine = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
        starts, ways = starts[fine], (ends - starts)[fine]
        length = np.linalg.norm(ways, axis=1)
        scales = np.column_stack([np.ones(len(length)), np.ones(len(length)), length])
        material = PreviewSurfaceCfg(diffuse_color=_linear(color))
        prototype = CylinderCfg(radius=_LINE, height=1.0, axis="Z", visual_material=material)
        self._place(prototype, starts + 0.5 * ways, _turns(ways, (0.0, 0.0, 1.0)), scales)

    def axes(self, poses: np.ndarray, length: float) -> None:
        """Draw frames."""
        poses = poses[np.isfinite(poses).all(axis=1)]
        prototype = FrameCfg(length=length, width=0.12 * length)
        self._place(prototype, poses[:, :3], poses[:, 3:], None)

    def _place(
        self, prototype: SpawnerCfg, positions: np.ndarray, turns: np.ndarray | None, scales: np.ndarray | None
    ) -> None:
        if not len(positions):
            self.hide()
            return
        if self._markers is None:
            cfg = VisualizationMarkersCfg(prim_path=f"/Visuals/{self._name}", markers={"one": prototype})
            self._markers = VisualizationMarkers(cfg, self._sim)
            self._markers.is_by_env = False
        self._markers.set_visibility(True)
        self._markers.visualize(positions, turns, scales)


def _linear(color: tuple[int, int, int]) -> tuple[float, float, float]:
    """A linear colour of 0 to 255 as one of 0 to 1."""
    red, green, blue = (c / 255.0 for c in color)
    return red, green, blue


def _turns(ways: np.ndarray, axis: tuple[float, float, float]) -> np.ndarray:
    """Shortest rotations of an axis to directions ``(n, 3)``: quaternions (x, y, z, w), shape ``(n, 4)``."""
    ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1.0e-12)
    turns = np.column_stack([np.cross(np.asarray(axis), ways), 1.0 + ways @ np.asarray(axis)])
    back = np.linalg.norm(turns, axis=1) < 1.0e-6
    turns[back] = (0.0, 1.0, 0.0, 0.0)  # half a turn about y, which x and z both stand on
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)
