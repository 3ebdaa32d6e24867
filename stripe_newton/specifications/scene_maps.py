# SPDX-License-Identifier: Apache-2.0
"""Scene maps: a picture of the height, the assets and every map of a scene's terrain."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .scene_spec import Scene

__all__ = ["draw_maps"]

_KNOWN: dict[str, tuple[str, str, tuple[float, float] | None]] = {
    "slope": ("slope [deg]", "YlOrBr", None),
    "aspect": ("direction of fall [deg]", "twilight", (-180.0, 180.0)),
    "moisture": ("moisture [0 to 1]", "YlGnBu", (0.0, 1.0)),
    "traversability": ("traversability [0 to 1]", "RdYlGn", (0.0, 1.0)),
}
"""Label, colour map and range of maps by name. Angles are in radians in the scene and in degrees in the picture."""
_MAX_CELLS = 700
"""Most cells of a map along a side; more would be smaller than pixels."""


def draw_maps(scene: Scene, path: Path) -> None:
    """Write a picture of the height, of all instances, and of every map of the terrain that is not even.

    Raises:
        ValueError: for a map that is no two-dimensional array of finite numbers.
    """
    # Here and not at the top: matplotlib takes long to import, and is needed when a map is drawn.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    terrain, maps = scene.terrain, _uneven_maps(scene)
    count = 2 + len(maps)
    columns = min(count, 3 if count != 4 else 2)
    rows = math.ceil(count / columns)
    high = 5.2 * min(max(terrain.size[1] / terrain.size[0], 0.35), 2.5)
    figure = Figure(figsize=(6.0 * columns, (high + 0.7) * rows), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)  # without pyplot, which keeps figures alive and may look for a display
    axes = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    _draw_height(figure, axes[0], scene)
    _draw_instances(axes[1], scene)
    for axis, (name, values) in zip(axes[2:], maps.items(), strict=False):
        _draw_map(figure, axis, scene, name, values)
    for axis in axes[:count]:
        axis.set_aspect("equal")
        axis.set_xlabel("x [m]")
        axis.set_ylabel("y [m]")
        _draw_scale_bar(axis, terrain.size)
    for axis in axes[count:]:
        axis.set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _uneven_maps(scene: Scene) -> dict[str, np.ndarray]:
    """Maps of the terrain by name, without those that have one value everywhere.

    Raises:
        ValueError: for a map that is no two-dimensional array of finite numbers.
    """
    maps = {name: np.asarray(values, dtype=float) for name, values in scene.terrain.maps.items()}
    for name, values in maps.items():
        if values.ndim != 2 or not np.isfinite(values).all():
            raise ValueError(f"terrain map '{name}': is {values.shape}, must be two-dimensional and finite")
    return {name: values for name, values in maps.items() if np.ptp(values) > 0.0}


def _draw_map(figure: Figure, axis: Axes, scene: Scene, name: str, values: np.ndarray) -> None:
    label, colors, limits = _KNOWN.get(name, (name.replace("_", " "), "viridis", None))
    shown = np.degrees(values) if "[deg]" in label else values
    # The quantile: a few cells of a cliff would otherwise leave everything else in one colour.
    low, top = limits or (float(shown.min()), float(np.quantile(shown, 0.995)))
    image = axis.imshow(_thin(shown), extent=_extent(scene), origin="lower", cmap=colors, vmin=low, vmax=top)
    figure.colorbar(image, ax=axis, fraction=0.045, pad=0.03, label=label)
    axis.set_title(name.replace("_", " "))


def _extent(scene: Scene) -> tuple[float, float, float, float]:
    (x, y), (width, height) = scene.terrain.ground.lower, scene.terrain.size
    return x, x + width, y, y + height


def _thin(values: np.ndarray) -> np.ndarray:
    """Every n-th value, so that the picture has no more cells than it can show."""
    step = max(1, math.ceil(max(values.shape) / _MAX_CELLS))
    return values[::step, ::step]


def _draw_relief(scene: Scene, axis: Axes, alpha: float) -> np.ndarray:
    """Draw the ground lit from the north-west; returns the heights that are drawn [m]."""
    from matplotlib.colors import LightSource  # see draw_maps

    heights = _thin(scene.terrain.ground.heights.astype(float))
    dx, dy = (s / (n - 1) for s, n in zip(scene.terrain.size, heights.shape[::-1], strict=True))
    # hillshade() expects the first row in the north, here it is in the south.
    shade = LightSource(azdeg=315.0, altdeg=45.0).hillshade(heights[::-1], vert_exag=2.0, dx=dx, dy=dy)[::-1]
    axis.imshow(shade, extent=_extent(scene), origin="lower", cmap="gray", vmin=0.0, vmax=1.0, alpha=alpha)
    return heights


def _draw_height(figure: Figure, axis: Axes, scene: Scene) -> None:
    heights, extent = _draw_relief(scene, axis, 1.0), _extent(scene)
    image = axis.imshow(heights, extent=extent, origin="lower", cmap="gist_earth", alpha=0.55)
    if np.ptp(heights) > 0.0:
        lines = axis.contour(heights, 8, extent=extent, origin="lower", colors="k", linewidths=0.5, alpha=0.6)
        axis.clabel(lines, fontsize=6, fmt="%.1f")
    figure.colorbar(image, ax=axis, fraction=0.045, pad=0.03, label="height [m]")
    axis.set_title(f"height, seed {scene.seed}")


def _draw_instances(axis: Axes, scene: Scene) -> None:
    """Draw the assets as dots, with a colour for each specification and an area that grows with the asset's size."""
    _draw_relief(scene, axis, 0.45)
    colors = ("#1b7837", "#7f3b08", "#762a83", "#2166ac", "#e08214", "#5aae61", "#35978f", "#c51b7d", "#b2abd2")
    for index, (name, placed) in enumerate(scene.terrain.placed.items()):
        if not placed:
            continue
        places = np.array([instance.position[:2] for instance in placed])
        scales = np.array([instance.scale for instance in placed])
        # Dots get smaller the more there are, so that they cover a similar share of the map.
        size = min(max(2.0e4 / max(len(scene.instances), 1), 1.0), 30.0) * (scales / scales.mean()) ** 2
        color = colors[index % len(colors)]
        axis.scatter(*places.T, s=size, c=color, label=f"{name} ({len(placed):,})", linewidths=0, alpha=0.85)
    x, y, _ = scene.terrain.origin or (0.0, 0.0, 0.0)
    axis.scatter([x], [y], marker="*", s=110, c="gold", edgecolors="k", linewidths=0.6, label="origin", zorder=5)
    legend = axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), fontsize=8, frameon=False, ncols=4)
    for handle in legend.legend_handles[:-1]:  # the last is the origin's star
        handle.set_sizes([28.0])
    left, right, low, top = _extent(scene)
    axis.set_xlim(left, right)
    axis.set_ylim(low, top)
    axis.set_title(f"{len(scene.instances):,} instances")


def _draw_scale_bar(axis: Axes, size: tuple[float, float]) -> None:
    """Draw a bar of a round length in the lower left corner."""
    about = 0.22 * size[0]
    unit = 10.0 ** math.floor(math.log10(about))
    length = unit * max(n for n in (1, 2, 5) if n * unit <= about)
    left, low = axis.get_xlim()[0] + 0.04 * size[0], axis.get_ylim()[0] + 0.04 * size[1]
    for color, width in (("white", 6.0), ("black", 2.5)):  # a white rim shows on any ground
        axis.plot([left, left + length], [low, low], color=color, linewidth=width, solid_capstyle="butt", zorder=6)
    box = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1.0}
    axis.text(
        left + 0.5 * length, low + 0.02 * size[1], f"{length:g} m", ha="center", va="bottom", fontsize=8, bbox=box
    )
