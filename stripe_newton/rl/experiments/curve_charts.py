# SPDX-License-Identifier: Apache-2.0
"""Charts of the curves of groups of runs: a PNG, and SVG that takes its colours from the page around it."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .html_page import COLORS
from .run_groups import Curve, Group, curve_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["X_LABELS", "chart_svg", "draw_png"]

X_LABELS = {"steps": "samples", "iterations": "iterations", "seconds": "seconds"}

_Dash: TypeAlias = "str | tuple[float, tuple[float, ...]]"
_DASHES: tuple[_Dash, ...] = ("-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)))
_TEXT, _GRID = "#010203", "#040506"
"""Placeholders for the colours of the page in an SVG; ``#0a0bNN`` is that of group NN."""


def draw_png(groups: Sequence[Group], metrics: Sequence[str], x: str, path: str | os.PathLike, title: str) -> Path:
    """Draw all metrics into a PNG, each in a chart of its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    columns = min(len(metrics), 2 if len(metrics) <= 4 else 3)
    rows = -(-len(metrics) // columns)
    names = [f"{group.name}  ({len(group.runs)})" for group in groups]
    width = 4.9 * columns
    # Matplotlib does not break legends into lines by itself.
    beside = max(1, min(len(names), int(width / (0.8 + 0.082 * max(map(len, names))))))  # entries in a line [in]
    figure = Figure(figsize=(width, 3.3 * rows + 0.7 + 0.23 * -(-len(names) // beside)), layout="constrained")
    FigureCanvasAgg(figure)
    axes_of = figure.subplots(rows, columns, squeeze=False).flatten()
    for axes, metric in zip(axes_of, metrics):
        _draw(axes, groups, metric, x, [COLORS[number % len(COLORS)][0] for number in range(len(groups))])
        axes.set_title(metric, fontsize=10.5, loc="left")
    for axes in axes_of[len(metrics) :]:
        axes.set_visible(False)
    lines = [
        Line2D([], [], color=COLORS[number % len(COLORS)][0], linestyle=_dash(number), linewidth=2.2)
        for number in range(len(groups))
    ]
    figure.legend(lines, names, loc="outside lower center", ncols=beside, frameon=False, fontsize=9.5)
    figure.suptitle(title, fontsize=10, color="#555b66")
    figure.savefig(path, dpi=110)
    return Path(path)


def chart_svg(groups: Sequence[Group], metric: str, x: str) -> str:
    """A chart of one metric as SVG, for a page that defines the colours ``--text``, ``--grid`` and ``--group-N``."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # Text as text, so that it is small and takes the page's font; a fixed salt and no date, so that equal curves give
    # equal files.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": metric, "font.family": "sans-serif"}):
        figure = Figure(figsize=(5.4, 3.3), layout="constrained")
        FigureCanvasSVG(figure)
        figure.patch.set_visible(False)
        axes = figure.subplots()
        axes.patch.set_visible(False)
        _draw(axes, groups, metric, x, [f"#0a0b{number:02x}" for number in range(len(groups))], _TEXT, _GRID)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    # Without the XML header, which HTML does not take, and without a size, so that the page sets it.
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r"(\d\.\d\d)\d+", r"\1", svg)  # hundredths of a point
    svg = re.sub(r"#0a0b([0-9a-f]{2})", lambda match: f"var(--group-{int(match[1], 16) % len(COLORS)})", svg)
    return svg.replace(_TEXT, "var(--text)").replace(_GRID, "var(--grid)")


def _dash(number: int) -> _Dash:
    """Line style of a group."""
    return _DASHES[number // len(COLORS) % len(_DASHES)]


def _draw(
    axes: Axes,
    groups: Sequence[Group],
    metric: str,
    x: str,
    colors: Sequence[str],
    text: str = "#30343b",
    grid: str = "#e3e6ea",
) -> None:
    from matplotlib.ticker import EngFormatter, MaxNLocator

    curves = [curve_of(group, metric, x) for group in groups]
    for number, curve in enumerate(curves):
        if curve is None:
            continue
        if len(curve.runs) > 1:
            for place, values in curve.runs:
                mark = "." if len(values) == 1 else None
                axes.plot(place, values, linewidth=0.7, alpha=0.35, zorder=2, color=colors[number], marker=mark)
            low, high = curve.mean - curve.half, curve.mean + curve.half
            axes.fill_between(curve.x, low, high, color=colors[number], alpha=0.14, linewidth=0, zorder=1)
        axes.plot(
            curve.x,
            curve.mean,
            linewidth=2.0,
            zorder=3,
            solid_capstyle="round",
            color=colors[number],
            linestyle=_dash(number),
            marker="o" if len(curve.x) == 1 else None,  # a run of one iteration is a point, which has no line
        )
    limits = _limits([curve for curve in curves if curve is not None])
    if limits is not None:
        axes.set_ylim(*limits)
    axes.margins(x=0.02)
    axes.set_xlabel(X_LABELS[x], color=text, fontsize=9.5)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.tick_params(colors=text, labelsize=9, length=0)
    axes.grid(color=grid, linewidth=0.8)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(grid)


def _limits(curves: Sequence[Curve]) -> tuple[float, float] | None:
    """Limits of y that show all runs. Wide bands are cut, so that they do not squeeze the curves."""
    values = np.concatenate([value for curve in curves for _, value in curve.runs]) if curves else np.array([])
    if not len(values):
        return None
    low, high = float(values.min()), float(values.max())
    room = (high - low) or abs(high) or 1.0
    ends = [low, high]
    for curve in curves:
        there = np.isfinite(curve.half)
        ends += [*(curve.mean - curve.half)[there], *(curve.mean + curve.half)[there]]
    return max(min(ends), low - 0.15 * room) - 0.03 * room, min(max(ends), high + 0.15 * room) + 0.03 * room
