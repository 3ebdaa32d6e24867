# SPDX-License-Identifier: Apache-2.0
"""Visualization markers: arrows, frames and shapes that pictures and the live view show, and that touch nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING

import newton
import numpy as np
import torch
from pxr import Usd, UsdGeom

from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.shape_mesh import shape_mesh
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.scene_context import scene_context

if TYPE_CHECKING:
    from .viewed_simulation import ViewedSimulation

__all__ = ["MarkerPart", "MarkerPlaces", "VisualizationMarkers", "VisualizationMarkersCfg"]

Values = torch.Tensor | np.ndarray | None


@dataclass
class MarkerPart:
    """A part of a prototype, in one colour."""

    mesh: newton.Mesh
    """Its triangles in the frame of the prototype."""
    color: tuple[float, float, float]
    """Its colour, sRGB."""


@dataclass
class MarkerPlaces:
    """Where the markers are: one row each."""

    positions: np.ndarray
    """World frame [m], shape ``(n, 3)``."""
    orientations: np.ndarray
    """Quaternions (x, y, z, w), shape ``(n, 4)``."""
    scales: np.ndarray
    """Factors along the axes of the prototype, shape ``(n, 3)``."""
    prototypes: np.ndarray
    """Prototype of each marker by index, shape ``(n,)``."""


@configclass
class VisualizationMarkersCfg:
    """Prototypes of markers."""

    prim_path: str = "/Visuals/markers"
    """Name of the markers. They are no prims: an exported scene is without them."""
    markers: dict[str, SpawnerCfg] = MISSING
    """Prototypes by name: any spawner, of which only what is visible counts."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.markers is not MISSING and not self.markers:
            yield "markers", "is empty, must have one prototype or more"


class VisualizationMarkers:
    """Copies of some prototypes, which are moved by :meth:`visualize`.

    Pictures, videos and the live view of a simulation show the markers that were made for it. Positions and the like
    are copied on the device; nothing waits for it until a picture is drawn.
    """

    def __init__(self, cfg: VisualizationMarkersCfg, sim: ViewedSimulation):
        """Make the markers; they appear with the first call of :meth:`visualize`.

        Args:
            cfg: The prototypes.
            sim: The simulation that they are shown with.

        Raises:
            ConfigError: ``cfg`` has a problem.
        """
        cfg.validate()
        self.cfg = cfg.copy()
        self.count = 0
        """Number of markers."""
        self.is_by_env = True
        """Whether a number of markers that the number of environments divides means that each environment has as many:
        pictures show those of theirs alone."""
        self._visible = True
        self._values: dict[str, torch.Tensor] = {}
        sim.markers.append(self)

    @property
    def num_prototypes(self) -> int:
        """Number of prototypes."""
        return len(self.cfg.markers)

    def set_visibility(self, visible: bool) -> None:
        """Show or hide all markers."""
        self._visible = visible

    def is_visible(self) -> bool:
        """Whether the markers are shown."""
        return self._visible

    def visualize(
        self,
        translations: Values = None,
        orientations: Values = None,
        scales: Values = None,
        marker_indices: Values | Sequence[int] = None,
    ) -> None:
        """Place the markers. What is None stays as it is, unless the number of markers changes.

        Args:
            translations: Positions in the world frame [m], shape ``(n, 3)``.
            orientations: Quaternions (x, y, z, w), shape ``(n, 4)``. Default: upright.
            scales: Factors along the axes of the prototype, shape ``(n, 3)``. Default: 1.
            marker_indices: Prototype of each marker by index, shape ``(n,)``. Default: the first.

        Raises:
            ValueError: a shape that does not fit, or another number of rows than the others have.
        """
        if not self._visible:
            return
        given = {"translations": translations, "orientations": orientations, "scales": scales}
        values = {name: _rows(name, value, 4 if name == "orientations" else 3) for name, value in given.items()}
        values["marker_indices"] = None if marker_indices is None else torch.as_tensor(marker_indices)
        counts = {name: len(value) for name, value in values.items() if value is not None}
        if len(set(counts.values())) > 1:
            text = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise ValueError(f"markers '{self.cfg.prim_path}': numbers of rows differ: {text}")
        if not counts:
            raise ValueError(f"markers '{self.cfg.prim_path}': visualize() was called without any values")
        count = next(iter(counts.values()))
        if count != self.count:
            self.count, self._values = count, {}
        for name, value in values.items():
            if value is not None:
                self._keep(name, value.detach())

    def _keep(self, name: str, value: torch.Tensor) -> None:
        old = self._values.get(name)
        # In place where that is possible: a recorded hook copies to the same memory at each replay.
        if old is not None and old.dtype == value.dtype and old.device == value.device:
            old.copy_(value)
        else:
            self._values[name] = value.clone()

    # -- for viewers

    def places(self) -> MarkerPlaces:
        """Where the markers are now, on the host; hidden ones are left out."""
        count = self.count if self._visible and "translations" in self._values else 0
        defaults = {
            "translations": np.zeros((count, 3)),
            "orientations": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            "scales": np.ones((count, 3)),
            "marker_indices": np.zeros(count, dtype=int),
        }
        found = {k: v.cpu().numpy() if count else defaults[k] for k, v in self._values.items()}
        values = defaults | found
        return MarkerPlaces(*(values[name][:count] for name in defaults))

    @cached_property
    def prototypes(self) -> list[list[MarkerPart]]:
        """Parts of each prototype, in the order of the config; none of one that is not visible."""
        return [_parts(name, spawner) for name, spawner in self.cfg.markers.items()]


def _rows(name: str, value: Values, width: int) -> torch.Tensor | None:
    if value is None:
        return None
    rows = torch.as_tensor(value)
    if rows.dim() != 2 or rows.shape[1] != width:
        raise ValueError(f"markers: {name} has shape {tuple(rows.shape)}, must be (n, {width})")
    return rows


def _parts(name: str, spawner: SpawnerCfg) -> list[MarkerPart]:
    """The visible shapes of a prototype as triangles in its frame, those of one colour together."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.DefinePrim("/World", "Xform")
    with scene_context(SimpleNamespace(stage=stage, alias=lambda path: path)):
        spawner.spawn(f"/World/{_valid(name)}")
    builder = newton.ModelBuilder()
    try:
        builder.add_usd(stage, load_visual_shapes=True, schema_resolvers=[])
    except ValueError as error:
        raise ConfigError([f"markers['{name}']: {error}"]) from error
    groups: dict[tuple[float, ...], list[tuple[np.ndarray, np.ndarray]]] = {}
    for shape in range(builder.shape_count):
        if int(builder.shape_flags[shape]) & int(newton.ShapeFlags.VISIBLE):
            color = tuple(float(c) for c in builder.shape_color[shape])
            groups.setdefault(color, []).append(_triangles(builder, shape))
    return [MarkerPart(_joined(pieces), (color[0], color[1], color[2])) for color, pieces in groups.items()]


def _valid(name: str) -> str:
    """A prim's name: letters, digits and underscores."""
    return "m_" + "".join(c if c.isalnum() else "_" for c in name)


def _triangles(builder: newton.ModelBuilder, shape: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a shape in the frame of the prototype."""
    scale = np.asarray(list(builder.shape_scale[shape]))
    label = builder.shape_label[shape]
    vertices, faces = shape_mesh(builder.shape_type[shape], scale, builder.shape_source[shape], label)
    vertices = _moved(builder.shape_transform[shape], vertices)
    if (body := builder.shape_body[shape]) >= 0:
        vertices = _moved(builder.body_q[body], vertices)
    return vertices, faces


def _moved(pose: Sequence[float], points: np.ndarray) -> np.ndarray:
    xform = np.asarray(list(pose), dtype=float)
    cross = 2.0 * np.cross(xform[3:6], points)
    return points + xform[6] * cross + np.cross(xform[3:6], cross) + xform[:3]


def _joined(pieces: list[tuple[np.ndarray, np.ndarray]]) -> newton.Mesh:
    """One mesh of several."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    vertices = np.concatenate([vertices for vertices, _ in pieces]).astype(np.float32)
    faces = np.concatenate([faces + start for (_, faces), start in zip(pieces, starts)])
    return newton.Mesh(vertices, faces.reshape(-1).astype(np.int32), compute_inertia=False)
