# SPDX-License-Identifier: Apache-2.0
"""LineChart: curves of a few runs as SVG text, which takes a millisecond and no plotting library."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Line", "chart_svg", "nice_ticks", "thin"]

_WIDTH, _HEIGHT = 340.0, 170.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 8.0, 8.0, 22.0
MOST_POINTS = 300
"""Points of a curve; longer ones are averaged over neighbours."""


@dataclass
class Line:
    """One curve of a chart."""

    x: np.ndarray
    """Places, ``(points,)``, increasing."""
    y: np.ndarray
    """Values, ``(points,)``; NaN where there is none, which interrupts the curve."""
    color: int = 0
    """Number of the colour ``--group-N`` of the page."""


def thin(x: np.ndarray, y: np.ndarray, most: int = MOST_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Means of x and y over neighbours, so that at most ``most`` points are left. Values that are not finite are NaN.

    A mean is over the finite values of its neighbours; it is NaN if there are none.
    """
    y = np.where(np.isfinite(y), y, np.nan)
    if len(x) <= most:
        return x, y
    bounds = np.linspace(0, len(x), most + 1).astype(int)[:-1]
    counts = np.diff([*bounds, len(x)])
    there = np.isfinite(y)
    found = np.add.reduceat(there.astype(float), bounds)
    sums = np.add.reduceat(np.where(there, y, 0.0), bounds)
    means = np.divide(sums, found, out=np.full(most, np.nan), where=found > 0)
    return np.add.reduceat(x.astype(float), bounds) / counts, means


def nice_ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers from ``low`` to ``high``, at most ``most``, in steps of 1, 2 or 5 times a power of ten."""
    span = high - low
    if not (math.isfinite(span) and span > 0.0 and most > 0):
        return []
    step = 10.0 ** math.floor(math.log10(span / most))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0, 20.0) if span / (step * factor) < most)
    first = math.ceil(low / step - 1e-9)
    # From whole numbers, so that a tick at zero is exactly zero.
    return [number * step for number in range(first, math.floor(high / step + 1e-9) + 1)]


def tick_text(value: float) -> str:
    """A number of an axis: short, with k, M or G for thousands, millions and milliards."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:.4g}{letter}"
    return f"{value:.4g}"


def chart_svg(lines: Sequence[Line], label: str) -> str:
    """A chart of curves, with ``label`` for screen readers; it must be escaped already.

    The lines' coordinates are attributes of the picture, from which the page's script finds the values at the pointer:
    ``data-x="low high"`` are the limits of x between the left and right edges of the curves.
    """
    lines = [line for line in lines if np.isfinite(line.y).any()]
    if not lines:
        return '<p class="empty">no values yet</p>'
    xs, ys = (np.concatenate([getattr(line, name) for line in lines]) for name in "xy")
    x_low, x_high = _limits(xs, 0.0)
    y_low, y_high = _limits(ys[np.isfinite(ys)], 0.06)
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def at_x(value: float) -> float:
        return _LEFT + (value - x_low) / (x_high - x_low) * (right - _LEFT)

    def at_y(value: float) -> float:
        return bottom - (value - y_low) / (y_high - y_low) * (bottom - _TOP)

    parts = [
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{label}" '
        f'data-x="{x_low:.9g} {x_high:.9g}" data-edges="{_LEFT:g} {right:g}">'
    ]
    for tick in nice_ticks(y_low, y_high, 5):
        place = at_y(tick)
        parts.append(f'<line class="grid" x1="{_LEFT:g}" x2="{right:g}" y1="{place:.1f}" y2="{place:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 5:g}" y="{place + 3.5:.1f}" text-anchor="end">{tick_text(tick)}</text>')
    for tick in nice_ticks(x_low, x_high, 5):
        place = at_x(tick)
        anchor = "end" if place > right - 12 else "middle"
        parts.append(f'<text x="{place:.1f}" y="{_HEIGHT - 6:g}" text-anchor="{anchor}">{tick_text(tick)}</text>')
    parts.append(f'<line class="axis" x1="{_LEFT:g}" x2="{right:g}" y1="{bottom:g}" y2="{bottom:g}"/>')
    for line in lines:
        parts += _curve(line, [at_x(value) for value in line.x], [at_y(value) for value in line.y])
    parts.append(f'<line class="pointer" y1="{_TOP:g}" y2="{bottom:g}" visibility="hidden"/></svg>')
    return "".join(parts)


def _limits(values: np.ndarray, room: float) -> tuple[float, float]:
    """Lowest and highest value with some room around them; never the same number twice."""
    low, high = float(values.min()), float(values.max())
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        half = 0.5 * abs(high) or 1.0
        return low - half, high + half
    return low - room * (high - low), high + room * (high - low)


def _curve(line: Line, x: Sequence[float], y: Sequence[float]) -> list[str]:
    """The stretches of a curve between places without a value; a stretch of one point is a dot."""
    color = f"var(--group-{line.color})"
    stretches: list[list[str]] = [[]]
    for across, up in zip(x, y):
        if math.isfinite(up):
            stretches[-1].append(f"{across:.1f},{up:.1f}")
        elif stretches[-1]:
            stretches.append([])
    found = []
    for points in filter(None, stretches):
        if len(points) == 1:
            across_text, _, up_text = points[0].partition(",")
            found.append(f'<circle cx="{across_text}" cy="{up_text}" r="2.2" style="fill: {color}"/>')
        else:
            found.append(f'<polyline class="curve" points="{" ".join(points)}" style="stroke: {color}"/>')
    return found
