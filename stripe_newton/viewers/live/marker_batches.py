# SPDX-License-Identifier: Apache-2.0
"""Marker batches: visualization markers as instanced meshes in a browser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stripe_newton.viewers.marker_slots import places_of_envs
from stripe_newton.viewers.markers import MarkerPart, MarkerPlaces, VisualizationMarkers
from stripe_newton.viewers.poses import wxyz
from stripe_newton.viewers.viewed_simulation import ViewedSimulation

from .live_scene import linear_bytes
from .view_frame import VIEW, ViewFrame

if TYPE_CHECKING:
    import viser

__all__ = ["MarkerBatches"]

_MOST = 4096
"""Most markers of a prototype that are drawn."""


class MarkerBatches:
    """Draws the markers of a simulation, those of the shown environments where each has some.

    Args:
        server: The web server.
        sim: The simulation; markers that are made later are drawn, too.
        frame: Where the world is in the scene.
    """

    def __init__(self, server: viser.ViserServer, sim: ViewedSimulation, frame: ViewFrame):
        self._server, self._sim, self._frame = server, sim, frame
        self.handles: dict[tuple[int, int, int], viser.BatchedMeshHandle] = {}
        """Instances by markers, prototype and part."""
        self._counts: dict[tuple[int, int, int], int] = {}
        self._visible = True

    def set_visible(self, visible: bool) -> None:
        """Show or hide all markers."""
        self._visible = visible
        for handle in self.handles.values():
            handle.visible = visible

    def update(self, env_ids: Sequence[int]) -> None:
        """Place the markers as they are now, for some environments."""
        if not self._visible:
            return
        for number, markers in enumerate(self._sim.markers):
            places = markers.places()
            if markers.is_by_env:
                places = places_of_envs(places, self._sim.env_origins, env_ids)
            self._update(number, markers, places)

    def _update(self, number: int, markers: VisualizationMarkers, places: MarkerPlaces) -> None:
        numbers = np.column_stack([places.positions, places.orientations, places.scales])
        finite = np.isfinite(numbers.astype(float)).all(axis=1)
        for prototype, parts in enumerate(markers.prototypes):
            rows = np.flatnonzero(finite & (places.prototypes == prototype))[:_MOST]
            for index, part in enumerate(parts):
                self._place((number, prototype, index), part, places, rows)

    def _place(self, key: tuple[int, int, int], part: MarkerPart, places: MarkerPlaces, rows: np.ndarray) -> None:
        handle = self.handles.get(key)
        if handle is not None and self._counts[key] != len(rows):  # viser keeps the number of instances
            self.handles.pop(key).remove()
            handle = None
        if not len(rows):
            return
        poses = self._frame.poses(np.column_stack([places.positions[rows], places.orientations[rows]]))
        positions, turns = poses[:, :3].astype(np.float32), wxyz(poses[:, 3:])
        scales = places.scales[rows].astype(np.float32)
        if handle is not None:
            handle.batched_positions, handle.batched_wxyzs, handle.batched_scales = positions, turns, scales
            return
        self._counts[key] = len(rows)
        self.handles[key] = self._server.scene.add_batched_meshes_simple(
            "{}/markers_{}_{}_{}".format(VIEW, *key),
            np.asarray(part.mesh.vertices),
            np.asarray(part.mesh.indices).reshape(-1, 3),
            batched_positions=positions,
            batched_wxyzs=turns,
            batched_scales=scales,
            batched_colors=linear_bytes(np.tile(part.color, (len(rows), 1))),
            lod="off",
            side="double",
            cast_shadow=False,
        )
