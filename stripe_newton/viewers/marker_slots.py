# SPDX-License-Identifier: Apache-2.0
"""Marker slots: bodies of a display model that stand for markers, and that are moved before each picture."""

from __future__ import annotations

from collections.abc import Sequence

import newton
import numpy as np
import warp as wp

from .markers import MarkerPlaces, VisualizationMarkers
from .viewed_simulation import ViewedSimulation

__all__ = ["MarkerSlots", "places_of_envs"]

_MOST = 512
"""Most markers of one kind that are drawn."""
_AWAY = (0.0, 0.0, -1.0e5, 0.0, 0.0, 0.0, 1.0)
"""Pose of slots that are not used [m]."""


class MarkerSlots:
    """Slots for the markers of a simulation in a display model, as many as there are now.

    Of markers that each environment has, those of the shown environments are drawn, else the first 512.

    Attributes:
        first_body: First body of the slots; those after it are slots, too.
    """

    def __init__(
        self, builder: newton.ModelBuilder, sim: ViewedSimulation, env_ids: Sequence[int], is_drawn: bool = True
    ):
        """Add the slots to ``builder``, as its last bodies and shapes; none without ``is_drawn``."""
        self._sim, self._env_ids, self._is_drawn = sim, np.asarray(env_ids, dtype=int), is_drawn
        self.first_body, self._first_shape = builder.body_count, builder.shape_count
        self._kinds = [(markers, self._room(markers)) for markers in sim.markers if is_drawn]
        self._shapes_of: list[list[int]] = []
        """Shapes of each slot."""
        shape = newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=False, has_particle_collision=False)
        for markers, room in self._kinds:
            for parts in markers.prototypes:
                for _ in range(room):
                    body = builder.add_link(xform=wp.transform(*_AWAY), label=f"marker_{builder.body_count}")
                    shapes = [builder.add_shape_mesh(body, mesh=p.mesh, cfg=shape, color=p.color) for p in parts]
                    self._shapes_of.append(shapes)
        self._poses = np.tile(np.array(_AWAY, dtype=np.float32), (len(self._shapes_of), 1))
        self._scales = np.ones((builder.shape_count - self._first_shape, 3), dtype=np.float32)

    def fit(self) -> bool:
        """Whether there are still as many markers as slots were made for."""
        now = [(markers, self._room(markers)) for markers in self._sim.markers if self._is_drawn]
        return len(now) == len(self._kinds) and all(
            markers is known and room <= there for (markers, room), (known, there) in zip(now, self._kinds)
        )

    def update(self, model: newton.Model, state: newton.State) -> None:
        """Move the slots to where the markers are."""
        if not self._shapes_of:
            return
        self._poses[:] = _AWAY
        slot = 0
        for markers, room in self._kinds:
            places = markers.places()
            if markers.is_by_env:
                places = places_of_envs(places, self._sim.env_origins, self._env_ids)
            for prototype in range(markers.num_prototypes):
                rows = np.flatnonzero(places.prototypes == prototype)[:room]
                for k, row in enumerate(rows):
                    self._place(slot + k, places, row)
                slot += room
        state.body_q[self.first_body :].assign(self._poses)
        model.shape_scale[self._first_shape : self._first_shape + len(self._scales)].assign(self._scales)

    def _place(self, slot: int, places: MarkerPlaces, row: int) -> None:
        pose = np.concatenate((places.positions[row], places.orientations[row]))
        if np.isfinite(pose).all():
            self._poses[slot] = pose
        for shape in self._shapes_of[slot]:
            self._scales[shape - self._first_shape] = places.scales[row]

    def _room(self, markers: VisualizationMarkers) -> int:
        """Number of slots for each prototype of some markers."""
        envs = self._sim.num_envs
        per_env = markers.is_by_env and markers.count % envs == 0
        return min(len(self._env_ids) * (markers.count // envs) if per_env else markers.count, _MOST)


def places_of_envs(places: MarkerPlaces, env_origins: np.ndarray, env_ids: Sequence[int] | np.ndarray) -> MarkerPlaces:
    """The markers of some environments; all, where their number says that they do not belong to environments.

    Args:
        places: All markers.
        env_origins: Origins of all environments [m], shape ``(num_envs, 3)``.
        env_ids: The environments.
    """
    count, envs = len(places.positions), len(env_origins)
    if not count or count % envs:
        return places
    each = count // envs
    # Rows are by environment, or by marker with all environments in each block: what is nearer to the origins.
    by_env, by_marker = np.repeat(np.arange(envs), each), np.tile(np.arange(envs), each)
    origins = env_origins[:, :2]
    far = [np.nanmedian(np.abs(places.positions[:, :2] - origins[owner])) for owner in (by_env, by_marker)]
    owner = by_env if far[0] <= far[1] else by_marker
    rows = np.isin(owner, env_ids)
    return MarkerPlaces(*(getattr(places, name)[rows] for name in MarkerPlaces.__dataclass_fields__))
