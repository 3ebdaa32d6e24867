# SPDX-License-Identifier: Apache-2.0
"""Plot panel: live curves of what somebody chooses: rewards, observations, forces, and whatever a task logs."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .inbox import Inbox
from .signals import Signal, is_number, signals_of
from .viewed_env import ViewedEnv

if TYPE_CHECKING:
    import torch
    import viser

__all__ = ["Plot", "PlotPanel"]

_OFF = "off"
_EVERY = 0.1
"""Time between two updates of a chart in the browser [s]."""
_POINTS = 400
"""Points of a curve."""
_MOST_PLOTS = 6
_COLORS = (
    "#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b",
    "#e377c2", "#7f7f7f", "#bcbd22", "#17becf", "#393b79", "#ad494a",
)  # fmt: skip
"""Colours of the curves in turn."""


class Plot:
    """A choice of a signal, and its chart.

    Args:
        gui: Where both go.
        inbox: Carries choices to the simulation's thread.
        number: Number of the plot, from 1.
        names: Names of the signals.
        start: The signal that is plotted at first.
    """

    def __init__(self, gui: viser.GuiApi, inbox: Inbox, number: int, names: Sequence[str], start: str):
        self._gui = gui
        self.folder = gui.add_folder(f"Plot {number}")
        with self.folder:
            self.choice = gui.add_dropdown("Of", (_OFF, *names), initial_value=start)
        self.chart: viser.GuiUplotHandle | None = None
        self._times: deque[float] = deque(maxlen=_POINTS)
        self._rows: deque[list[float]] = deque(maxlen=_POINTS)
        self._curves: list[str] = []
        self._charted: list[str] = []
        """Names of the curves that the chart was made for."""
        inbox.on_change(self.choice, lambda _: self._choose())

    @property
    def name(self) -> str | None:
        """The chosen signal; None for none."""
        return None if self.choice.value == _OFF else str(self.choice.value)

    def _choose(self) -> None:
        """Begin anew, with another signal or none."""
        self.clear()
        self._remove_chart()

    def clear(self) -> None:
        """Begin the curves anew. The chart stays, as a browser may still be told of its values."""
        self._times.clear()
        self._rows.clear()
        if self.chart is not None:
            self.chart.data = (np.zeros(0),) * (1 + len(self._charted))

    def _remove_chart(self) -> None:
        if self.chart is not None:
            self.chart.remove()
            self.chart = None

    def add(self, seconds: float, curves: list[str], values: Sequence[float]) -> None:
        """Add a point to each curve."""
        if curves != self._curves:
            self.clear()
            self._curves = curves
        if self._times and seconds < self._times[-1]:  # time began anew
            self.clear()
        if self._times and seconds == self._times[-1]:
            return
        self._times.append(seconds)
        self._rows.append([float(v) for v in values])

    def data(self) -> tuple[np.ndarray, ...]:
        """Times and the values of each curve; not finite ones are gaps."""
        values = np.array(self._rows, dtype=float).reshape(len(self._rows), len(self._curves))
        values[~np.isfinite(values)] = np.nan
        return np.array(self._times), *values.T.copy()

    def draw(self) -> None:
        """Show the curves."""
        if self.name is None or len(self._times) < 2:
            return
        if self.chart is not None and self._charted == self._curves:
            self.chart.data = self.data()
            return
        self._remove_chart()
        self._charted = self._curves
        series: list[viser.uplot.Series] = [{"label": "t [s]"}]
        series += [
            {"label": name, "stroke": _COLORS[k % len(_COLORS)], "width": 1.5, "points": {"show": False}}
            for k, name in enumerate(self._curves)
        ]
        with self.folder:
            self.chart = self._gui.add_uplot(
                self.data(), tuple(series), scales={"x": {"time": False, "auto": True}}, height=190,
                legend={"show": True, "live": False},
            )  # fmt: skip


class PlotPanel:
    """Plots, and a button for more of them.

    Args:
        gui: Makes the widgets.
        parent: Where they go.
        inbox: Carries choices to the simulation's thread.
        env: The environment.
        chosen: The environment by number that is plotted.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        parent: viser.GuiTabHandle | viser.GuiFolderHandle,
        inbox: Inbox,
        env: ViewedEnv,
        chosen: Callable[[], int],
    ):
        self._gui, self._parent, self._inbox, self._env, self._chosen = gui, parent, inbox, env, chosen
        self._signals: dict[str, Signal] = {signal.name: signal for signal in signals_of(env)}
        self._log: dict[str, float | torch.Tensor] = {}
        self._next = 0.0
        self.plots: list[Plot] = []
        with parent:
            self.more = gui.add_button("One more plot", icon="plus", order=1.0e6)
        inbox.on_click(self.more, self._add_more)

    @property
    def names(self) -> list[str]:
        """Names of all that can be plotted now."""
        return [*self._signals, *(f"log: {name}" for name in self._log)]

    def add(self, start: str | None = None) -> Plot:
        """Add a plot of a signal; by default, of nothing yet."""
        with self._parent:
            plot = Plot(self._gui, self._inbox, len(self.plots) + 1, self.names, start or _OFF)
        self.plots.append(plot)
        self.more.visible = len(self.plots) < _MOST_PLOTS
        return plot

    def _add_more(self) -> None:
        self.add()

    def after_step(self) -> None:
        """Keep what the step logged, without reading it: some tasks log only in steps in which episodes end."""
        found = {str(name): value for name, value in (self._env.extras.get("log") or {}).items() if is_number(value)}
        new = found.keys() - self._log.keys()
        self._log |= found
        if new:
            self._offer()

    def _offer(self) -> None:
        """Offer all signals in every choice."""
        for plot in self.plots:
            chosen = plot.choice.value
            plot.choice.options = (_OFF, *self.names)
            self._inbox.set_quietly(plot.choice, chosen)

    def clear(self) -> None:
        """Begin all curves anew, as for another environment."""
        for plot in self.plots:
            plot.clear()

    def sample(self, seconds: float) -> None:
        """Add the present values.

        Args:
            seconds: Simulated time [s].
        """
        for plot in self.plots:
            if (name := plot.name) is None:
                continue
            if (signal := self._signals.get(name)) is not None:
                plot.add(seconds, signal.curves, signal.read(self._chosen()))
            else:
                key = name.removeprefix("log: ")
                plot.add(seconds, [key], [float(self._log.get(key, math.nan))])

    def update(self, seconds: float) -> None:
        """Add the present values, and show the curves a few times a second; the argument is that of :meth:`sample`."""
        self.sample(seconds)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + _EVERY
            for plot in self.plots:
                plot.draw()
