# SPDX-License-Identifier: Apache-2.0
"""Report page: the HTML of a report, from runs that were read; it loads nothing and runs from a file."""

from __future__ import annotations

import base64
import html
import json
import math
import os
import re
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from urllib.parse import quote

import numpy as np

from stripe_newton.rl.experiments.curve_charts import X_LABELS
from stripe_newton.rl.experiments.html_page import COLORS, html_document, html_table
from stripe_newton.rl.experiments.text_tables import format_number

from .line_chart import Line, chart_svg, thin
from .report_data import ReportedRun, changed_fields, sort_columns

__all__ = ["MOST_FILM_BYTES", "report_html"]

MOST_FILM_BYTES = 1_500_000
"""Larger films are linked from the page, smaller ones are in it."""
_SECONDS_TO_RELOAD = 30

_STYLE = """
.charts.small { grid-template-columns: repeat(auto-fill, minmax(min(100%, 17rem), 1fr)); gap: .8rem; }
.charts figure { padding: .55rem .7rem .2rem; } .charts svg { touch-action: pan-y; }
figcaption { display: flex; justify-content: space-between; gap: .8rem; font-size: .9em; }
figcaption .now { color: var(--soft); font-weight: 400; white-space: nowrap; font-variant-numeric: tabular-nums; }
svg text { fill: var(--soft); font-size: 10.5px; } .grid { stroke: var(--grid); stroke-width: .8; }
.axis { stroke: var(--soft); stroke-width: .8; opacity: .6; } .pointer { stroke: var(--soft); stroke-dasharray: 3 3; }
.curve { fill: none; stroke-width: 1.7; stroke-linejoin: round; stroke-linecap: round; }
.empty { padding: 2rem 0; text-align: center; }
.facts { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 9.5rem), 1fr)); gap: .5rem 1.4rem;
  background: var(--card); border-radius: 10px; padding: .8rem 1rem; margin: .9rem 0; }
.facts dt { color: var(--soft); font-size: .82em; } .facts dd { margin: 0; overflow-wrap: anywhere; }
.bar { display: flex; height: .7rem; border-radius: 5px; overflow: hidden; background: var(--grid); margin: .5rem 0; }
.bar span { display: block; } .done { background: var(--group-2); }
video { width: 100%; max-width: 36rem; border-radius: 10px; display: block; background: #000; }
"""

# Shows the values at the pointer in the caption of a chart. Each chart keeps its thinned curves in the JSON block.
_SCRIPT = """
const charts = JSON.parse(document.getElementById("curves").textContent);
document.querySelectorAll("figure[data-chart]").forEach(figure => {
  const svg = figure.querySelector("svg"), now = figure.querySelector(".now");
  if (!svg || !now) return;
  const lines = charts[figure.dataset.chart], last = now.textContent, pointer = svg.querySelector(".pointer");
  const [low, high] = svg.dataset.x.split(" ").map(Number), [left, right] = svg.dataset.edges.split(" ").map(Number);
  svg.addEventListener("pointermove", event => {
    const box = svg.getBoundingClientRect(), at = (event.clientX - box.left) / box.width * svg.viewBox.baseVal.width;
    const x = low + (at - left) / (right - left) * (high - low);
    const found = lines.map(line => {
      let best = 0;
      line.x.forEach((value, index) => { if (Math.abs(value - x) < Math.abs(line.x[best] - x)) best = index; });
      return [line.x[best], line.y[best]];
    });
    if (!found.length) return;
    const place = left + (found[0][0] - low) / (high - low) * (right - left);
    pointer.setAttribute("x1", place); pointer.setAttribute("x2", place); pointer.setAttribute("visibility", "visible");
    const text = value => value === null ? "-" : Number(value.toPrecision(4)).toString();
    now.textContent = "at " + text(found[0][0]) + ": " + found.map(pair => text(pair[1])).join(" | ");
  });
  svg.addEventListener("pointerleave", () => {
    pointer.setAttribute("visibility", "hidden"); now.textContent = last;
  });
});
"""


def report_html(runs: Sequence[ReportedRun], x: str, folder: Path, live: bool = False) -> str:
    """The report of one run, or of several beside each other, as one HTML page.

    Args:
        runs: The runs; curves of one have one colour.
        x: x axis of the curves: ``iterations``, ``steps`` or ``seconds``.
        folder: Folder of the page, which links to large films are relative to.
        live: Whether the training goes on, so that an open page loads itself again now and then.
    """
    page = _Page(runs, x, folder, live)
    sections = [*page.head(), *page.facts(), *page.times(), *page.films(), *page.charts(), *page.changes(), page.end()]
    head = f'<meta http-equiv="refresh" content="{_SECONDS_TO_RELOAD}">\n' if live else ""
    return html_document(page.title, sections, _STYLE, head)


class _Page:
    """Sections of the report, each as HTML."""

    def __init__(self, runs: Sequence[ReportedRun], x: str, folder: Path, live: bool):
        self._runs, self._x, self._folder, self._live = runs, x, folder, live
        self._curves: list[list[dict[str, list[float | None]]]] = []
        """Curves of each chart, for the script."""

    @property
    def title(self) -> str:
        """Tasks of the runs, and the run's name or their number."""
        tasks = dict.fromkeys(str(run.log.config.get("run.task") or run.log.label) for run in self._runs)
        what = self._runs[0].name if len(self._runs) == 1 else f"{len(self._runs)} runs"
        return f"{', '.join(tasks)}: {what}"

    def _key(self, number: int) -> str:
        """The colour of a run, as a small mark."""
        return f'<span class="key" style="background: var(--group-{number % len(COLORS)})"></span>'

    def _heads(self, first: Sequence[str]) -> list[str]:
        """Cells of a header: ``first``, and then the runs."""
        names = [self._key(number) + html.escape(run.name) for number, run in enumerate(self._runs)]
        return [*map(html.escape, first), *(names if len(self._runs) > 1 else ["this run"])]

    def head(self) -> list[str]:
        """Title, how far the training is, and which colour is whose."""
        parts = [f"<h1>{html.escape(self.title)}</h1>"]
        if len(self._runs) == 1:
            return [*parts, *self._progress(self._runs[0])]
        items = (
            f"<li>{self._key(number)}{html.escape(run.name)}, {run.iterations} iterations</li>"
            for number, run in enumerate(self._runs)
        )
        return [*parts, f'<ul class="legend">{"".join(items)}</ul>']

    def _progress(self, run: ReportedRun) -> list[str]:
        planned = run.planned or run.iterations
        share = 100.0 * min(1.0, run.iterations / planned)
        state = "training: " if self._live else ""
        written = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %Z")
        again = f"; this page loads itself again every {_SECONDS_TO_RELOAD} s" if self._live else ""
        return [
            f'<div class="bar"><span class="done" style="width: {share:.1f}%"></span></div>',
            f"<p>{state}{run.iterations} of {planned} iterations, written {written}{again}</p>",
        ]

    def facts(self) -> list[str]:
        """Seed, number of environments, device, versions and commit of each run."""
        if len(self._runs) > 1:
            names = dict.fromkeys(name for run in self._runs for name in _facts(run))
            rows = [
                ([html.escape(name), *(html.escape(_facts(run).get(name, "-")) for run in self._runs)], False)
                for name in names
            ]
            return ["<h2>Runs</h2>", html_table(self._heads(["fact"]), rows, "fields")]
        items = "".join(
            f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd></div>"
            for name, value in _facts(self._runs[0]).items()
        )
        return [f'<dl class="facts">{items}</dl>']

    def times(self) -> list[str]:
        """The table of durations, with the parts of an iteration."""
        rows = []
        for number, run in enumerate(self._runs):
            times, seconds = run.times(), float(run.log.x["seconds"][-1])
            cells = [
                self._key(number) + html.escape(run.name),
                format_number(run.iterations),
                format_number(float(run.log.x["steps"][-1])),
                str(timedelta(seconds=round(seconds))) if math.isfinite(seconds) else "-",
                _whole(run.samples_per_s()),
                _milliseconds(times.iteration),
                *(_part(part, times.rollout + times.update) for part in (times.rollout, times.update)),
            ]
            rows.append((cells, False))
        head = ["run", "iterations", "samples", "time", "samples/s", "iteration", "rollout", "update"]
        note = (
            "Time of training, without the start of the program. Rollout: policy, physics and task. "
            "Means over all iterations."
        )
        return ["<h2>Times</h2>", html_table(head, rows), f"<p>{note}</p>"]

    def films(self) -> list[str]:
        """The newest film of each run: in the page if it is small, else linked."""
        parts = []
        for number, run in enumerate(self._runs):
            if run.film is not None and (source := _film_source(run.film, self._folder)):
                name = f"{self._key(number)}{html.escape(run.name)}: " if len(self._runs) > 1 else ""
                parts.append(
                    f"<figure><figcaption><span>{name}{html.escape(run.film.name)}</span></figcaption>"
                    f'<video controls loop muted playsinline preload="metadata" src="{source}"></video></figure>'
                )
        return ["<h2>Film</h2>", '<div class="charts">', *parts, "</div>"] if parts else []

    def charts(self) -> list[str]:
        """Charts of all columns under their headings."""
        parts = []
        for heading, columns in sort_columns(self._runs).items():
            parts += [f"<h2>{html.escape(heading)}</h2>", '<div class="charts small">']
            parts += [self._chart(column) for column in columns]
            parts.append("</div>")
        label = X_LABELS[self._x]
        return [*parts, f"<p>All curves are over {label}. Long curves are means over neighbouring points.</p>"]

    def _chart(self, column: str) -> str:
        lines = []
        for number, run in enumerate(self._runs):
            if column in run.log.columns:
                x, y = thin(run.log.x[self._x], run.log.columns[column])
                lines.append(Line(x, y, number % len(COLORS)))
        name = html.escape(column.partition("/")[2] or column)
        breakable = re.sub("([/_])", r"\1<wbr>", name)  # lines of long names end there rather than within a word
        last = " | ".join(format_number(run.last(column)) for run in self._runs)
        number = len(self._curves)
        self._curves.append([{"x": _json_numbers(line.x), "y": _json_numbers(line.y)} for line in lines])
        return (
            f'<figure data-chart="{number}" data-column="{html.escape(column)}"><figcaption><span>{breakable}</span>'
            f'<span class="now">{last}</span></figcaption>{chart_svg(lines, name)}</figure>'
        )

    def changes(self) -> list[str]:
        """The table of fields that differ from the task's default, or between the runs."""
        heading = "<h2>Settings that differ from the task's default</h2>"
        if len(self._runs) > 1:
            heading = "<h2>Settings that differ from the task's default, or between the runs</h2>"
        rows = [
            ([html.escape(name), html.escape(default), *map(html.escape, values)], False)
            for name, default, values in changed_fields(self._runs)
        ]
        if rows:
            return [heading, html_table(self._heads(["field", "default"]), rows, "fields")]
        known = all(run.facts.changes is not None for run in self._runs)
        return [heading, f"<p>{'None.' if known else 'The run does not say: stripe-newton train keeps them.'}</p>"]

    def end(self) -> str:
        """Folders of the runs, and the curves for the script."""
        items = "".join(f"<li><code>{html.escape(str(run.log.path))}</code></li>" for run in self._runs)
        # In a script only "<" could end the block; its escape is JSON, too.
        curves = json.dumps(self._curves, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        return (
            f"<details><summary>Folders</summary><ul>{items}</ul></details>\n"
            f'<script type="application/json" id="curves">{curves}</script>\n<script>{_SCRIPT}</script>'
        )


def _facts(run: ReportedRun) -> dict[str, str]:
    """Facts about a run, by name, for the table of the report."""
    config, system = run.log.config, dict(run.facts.system)
    seed = config.get("agent.seed", config.get("env.seed"))
    facts = {
        "task": config.get("run.task"),
        "device": system.pop("device", None) or config.get("env.sim.device"),
        "environments": config.get("env.scene.num_envs"),
        "seed": seed,
        "started": system.pop("started", None),
    }
    facts |= system
    for name, value in config.items():
        if name.startswith("git.") and name.endswith(".commit"):
            clean = config.get(name.replace(".commit", ".uncommitted_changes")) == "none"
            facts[f"commit of {name[4:-7]}"] = f"{value}{'' if clean else ', with changes'}"
    return {name: format_number(value) for name, value in facts.items() if value is not None}


def _film_source(film: Path, folder: Path) -> str:
    """Address of a film for the page; empty if it cannot be read."""
    try:
        if film.stat().st_size <= MOST_FILM_BYTES:
            return "data:video/mp4;base64," + base64.b64encode(film.read_bytes()).decode("ascii")
    except OSError:
        return ""
    return quote(os.path.relpath(film.resolve(), folder.resolve()).replace(os.sep, "/"))


def _json_numbers(values: np.ndarray) -> list[float | None]:
    """Numbers with seven digits, as float32 has them; None for those that are not finite, which JSON lacks."""
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in values]


def _whole(value: float) -> str:
    return format_number(round(value)) if math.isfinite(value) else "-"


def _milliseconds(seconds: float) -> str:
    return f"{format_number(1000.0 * seconds)} ms" if math.isfinite(seconds) else "-"


def _part(seconds: float, whole: float) -> str:
    share = f" ({100.0 * seconds / whole:.0f} %)" if math.isfinite(seconds) and whole > 0.0 else ""
    return _milliseconds(seconds) + share
