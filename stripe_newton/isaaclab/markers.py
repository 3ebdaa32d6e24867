# SPDX-License-Identifier: Apache-2.0
"""Markers of the Isaac Lab dialect: those of stripe_newton with quaternions (w, x, y, z), and Isaac Lab's configs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from stripe_newton.configclass import configclass
from stripe_newton.sim import PreviewSurfaceCfg, Simulation
from stripe_newton.viewers.markers import VisualizationMarkers as NativeMarkers
from stripe_newton.viewers.markers import VisualizationMarkersCfg as NativeMarkersCfg

from .files import ISAAC_NUCLEUS_DIR
from .latest_simulation import latest_simulation
from .quaternions import to_xyzw
from .spawners import CuboidCfg, CylinderCfg, SphereCfg, UsdFileCfg

__all__ = [
    "BLUE_ARROW_X_MARKER_CFG",
    "CONTACT_SENSOR_MARKER_CFG",
    "CUBOID_MARKER_CFG",
    "DEFORMABLE_TARGET_MARKER_CFG",
    "FRAME_MARKER_CFG",
    "GREEN_ARROW_X_MARKER_CFG",
    "POSITION_GOAL_MARKER_CFG",
    "RAY_CASTER_MARKER_CFG",
    "RED_ARROW_X_MARKER_CFG",
    "SPHERE_MARKER_CFG",
    "VisualizationMarkers",
    "VisualizationMarkersCfg",
]

Values = torch.Tensor | np.ndarray | None
Color = tuple[float, float, float]


@configclass
class VisualizationMarkersCfg(NativeMarkersCfg):
    """:class:`stripe_newton.viewers.VisualizationMarkersCfg`."""


class VisualizationMarkers(NativeMarkers):
    """:class:`stripe_newton.viewers.VisualizationMarkers` of the latest simulation; quaternions are (w, x, y, z)."""

    def __init__(self, cfg: NativeMarkersCfg, sim: Simulation | None = None):
        chosen = latest_simulation() if sim is None else sim
        if chosen is None:
            raise RuntimeError(f"markers '{cfg.prim_path}': there is no simulation to show them with")
        super().__init__(cfg, chosen)

    @property
    def prim_path(self) -> str:
        """Name of the markers."""
        return str(self.cfg.prim_path)

    def visualize(
        self,
        translations: Values = None,
        orientations: Values = None,
        scales: Values = None,
        marker_indices: Values | Sequence[int] = None,
    ) -> None:
        turned = None if orientations is None else to_xyzw(torch.as_tensor(orientations))
        super().visualize(translations, turned, scales, marker_indices)


def _paint(color: Color) -> PreviewSurfaceCfg:
    return PreviewSurfaceCfg(diffuse_color=color)


def _balls(radius: float, **colors: Color | None) -> VisualizationMarkersCfg:
    """Balls by name and colour; one without a colour is not drawn."""
    markers = {
        name: SphereCfg(radius=radius, visible=color is not None, visual_material=_paint(color or _GREEN))
        for name, color in colors.items()
    }
    return VisualizationMarkersCfg(markers=dict(markers))


def _arrow(color: Color) -> VisualizationMarkersCfg:
    """An arrow along x."""
    path = f"{ISAAC_NUCLEUS_DIR}/Props/UIElements/arrow_x.usd"
    arrow = UsdFileCfg(usd_path=path, scale=(1.0, 0.1, 0.1), visual_material=_paint(color))
    return VisualizationMarkersCfg(markers={"arrow": arrow})


_RED, _GREEN, _BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

RAY_CASTER_MARKER_CFG = _balls(0.02, hit=_RED)
CONTACT_SENSOR_MARKER_CFG = _balls(0.02, contact=_RED, no_contact=None)
DEFORMABLE_TARGET_MARKER_CFG = _balls(0.02, target=(1.0, 0.75, 0.8))
POSITION_GOAL_MARKER_CFG = _balls(0.01, target_far=_RED, target_near=_GREEN, target_invisible=None)
SPHERE_MARKER_CFG = _balls(0.05, sphere=_RED)
CUBOID_MARKER_CFG = VisualizationMarkersCfg(
    markers={"cuboid": CuboidCfg(size=(0.1, 0.1, 0.1), visual_material=_paint(_RED))}
)
RED_ARROW_X_MARKER_CFG, GREEN_ARROW_X_MARKER_CFG, BLUE_ARROW_X_MARKER_CFG = map(_arrow, (_RED, _GREEN, _BLUE))
FRAME_MARKER_CFG = VisualizationMarkersCfg(
    markers={
        "frame": UsdFileCfg(usd_path=f"{ISAAC_NUCLEUS_DIR}/Props/UIElements/frame_prim.usd", scale=(0.5, 0.5, 0.5)),
        "connecting_line": CylinderCfg(radius=0.002, height=1.0, visual_material=_paint((1.0, 1.0, 0.0))),
    }
)
