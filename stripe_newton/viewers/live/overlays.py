# SPDX-License-Identifier: Apache-2.0
"""Overlays: commands and measurements of sensors drawn into the live view, each with a checkbox."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from stripe_newton.viewers.layers import command_layers, sensor_layers
from stripe_newton.viewers.poses import wxyz
from stripe_newton.viewers.viewed_simulation import ViewedSimulation

from .inbox import Inbox
from .marker_batches import MarkerBatches
from .view_frame import VIEW, ViewFrame
from .viewed_env import ViewedEnv

if TYPE_CHECKING:
    import viser

__all__ = ["Overlays"]

_SHORTEST = 0.08
"""Length below which an arrow is not drawn, as it would be all head [m]."""


class Layer(Protocol):
    """Something that is drawn, or not."""

    name: str
    is_on: bool
    """Whether it is drawn at first."""

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        """Draw it for the shown environments or the chosen one."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""


class _Drawing:
    """A node of the scene that is made at its first use; its points may change in number."""

    def __init__(self, server: viser.ViserServer, frame: ViewFrame, name: str):
        self._server, self._frame, self._path = server, frame, f"{VIEW}/overlay/{name}"
        self._handle: Any = None
        self._count = -1

    def hide(self) -> None:
        """Take it off the scene."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None

    def arrows(self, starts: np.ndarray, ways: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw arrows from ``starts``, ``(n, 3)``, along ``ways``, ``(n, 3)`` [m]."""
        long = np.isfinite(starts).all(axis=1) & (np.linalg.norm(np.nan_to_num(ways), axis=1) > _SHORTEST)
        points = self._points(np.stack([starts[long], (starts + ways)[long]], axis=1))
        if self._needs(points):
            self._handle = self._server.scene.add_arrows(
                self._path, points, color, shaft_radius=0.012, head_radius=0.03, head_length=0.07
            )

    def points(self, points: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw points, ``(n, 3)`` [m]; those that are not finite are left out."""
        points = self._points(points[np.isfinite(points).all(axis=1)])
        if self._needs(points):
            self._handle = self._server.scene.add_point_cloud(
                self._path, points, color, point_size=0.018, point_shape="circle", precision="float32"
            )

    def lines(self, starts: np.ndarray, ends: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw lines between points, ``(n, 3)`` [m]; those that are not finite are left out."""
        fine = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
        points = self._points(np.stack([starts[fine], ends[fine]], axis=1))
        if self._needs(points):
            self._handle = self._server.scene.add_line_segments(
                self._path, points, color, thickness=1.0, thickness_units="screen"
            )

    def axes(self, poses: np.ndarray, length: float) -> None:
        """Draw frames, poses ``(n, 7)``."""
        poses = self._frame.poses(poses[np.isfinite(poses).all(axis=1)])
        if len(poses) != self._count or self._handle is None:
            self.hide()
            self._count = len(poses)
            if len(poses):
                self._handle = self._server.scene.add_batched_axes(
                    self._path, wxyz(poses[:, 3:]), poses[:, :3].astype(np.float32),
                    axes_length=length, axes_radius=0.06 * length,
                )  # fmt: skip
            return
        self._handle.batched_positions, self._handle.batched_wxyzs = poses[:, :3].astype(np.float32), wxyz(poses[:, 3:])

    def _points(self, points: np.ndarray) -> np.ndarray:
        """Points of the world in the scene, float32, of any shape ``(..., 3)``."""
        return self._frame.points(points).astype(np.float32)

    def _needs(self, points: np.ndarray) -> bool:
        """Whether the node has to be made; otherwise its points are set."""
        if self._handle is None or len(points) != self._count:
            self.hide()
            self._count = len(points)
            return len(points) > 0
        if len(points):
            self._handle.points = points
        return False


class Overlays:
    """Checkboxes for all that can be drawn.

    Args:
        server: The web server.
        gui: Where the checkboxes go.
        inbox: Carries changes to the simulation's thread.
        sim: The simulation.
        env: Its environment; None for a scene without one.
        frame: Where the world is in the scene.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        gui: viser.GuiApi,
        inbox: Inbox,
        sim: ViewedSimulation,
        env: ViewedEnv | None,
        frame: ViewFrame,
    ):
        self.layers: dict[str, Layer] = {}
        self.boxes: dict[str, viser.GuiCheckboxHandle] = {}
        make = partial(_Drawing, server, frame)
        layers: list[Layer] = [_Markers(server, sim, frame), *command_layers(make, env), *sensor_layers(make, env)]
        self.layers |= {layer.name: layer for layer in layers}
        self._markers = sim.markers
        self._folder = gui.add_folder("Draw")
        with self._folder:
            for name, layer in self.layers.items():
                self.boxes[name] = gui.add_checkbox(name, initial_value=layer.is_on)
                inbox.on_change(self.boxes[name], layer.set_visible)

    def draw(self, name: str, env_ids: Sequence[int], chosen: int) -> None:
        """Draw a layer if it is switched on.

        Args:
            name: The layer.
            env_ids: The shown environments.
            chosen: The chosen one.
        """
        if name == _Markers.name:  # which may be made at any time
            self.boxes[name].visible = has_markers = len(self._markers) > 0
            self._folder.visible = has_markers or len(self.layers) > 1
        if self.boxes[name].value:
            self.layers[name].update(env_ids, chosen)


class _Markers:
    """Visualization markers of the simulation."""

    name = "markers"
    is_on = True

    def __init__(self, server: viser.ViserServer, sim: ViewedSimulation, frame: ViewFrame):
        self._batches = MarkerBatches(server, sim, frame)

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        self._batches.update(env_ids)

    def set_visible(self, visible: bool) -> None:
        self._batches.set_visible(visible)
