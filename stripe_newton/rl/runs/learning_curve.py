# SPDX-License-Identifier: Apache-2.0
"""Learning curve of a run: return and episode length over iterations, as a picture."""

from __future__ import annotations

import os
from pathlib import Path

from .metrics_csv import read_metrics

__all__ = ["plot_learning_curve"]

_CURVES = (("Train/mean_reward", "mean return"), ("Train/mean_episode_length", "mean episode length (steps)"))


def plot_learning_curve(metrics: str | os.PathLike, path: str | os.PathLike, title: str = "") -> Path:
    """Draw return and episode length over iterations from a ``metrics.csv``.

    Args:
        metrics: The ``metrics.csv``.
        path: The picture, such as ``learning_curve.png``.
        title: Text above the curves.

    Raises:
        ValueError: if no episode ended in the whole run, so that there is nothing to draw.
    """
    # Here, as a training needs matplotlib at its end alone. Figure and canvas without pyplot, which would keep the
    # figure and may ask for a display.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = read_metrics(metrics)
    curves = [(columns[name], label) for name, label in _CURVES if name in columns]
    if not curves:
        raise ValueError(f"{metrics}: no episode has ended yet")
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (values, label) in zip(figure.subplots(1, len(curves), squeeze=False)[0], curves, strict=True):
        axes.plot([iteration + 1 for iteration in columns["iteration"]], values, linewidth=1.6)
        axes.set_xlabel("iteration")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    figure.savefig(path, dpi=120)
    return Path(path)
