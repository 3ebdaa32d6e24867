# SPDX-License-Identifier: Apache-2.0
"""Comparison of groups of runs: as tables of text, and as one HTML file without scripts."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .curve_charts import X_LABELS, chart_svg
from .html_page import COLORS, html_document, html_table
from .loaded_runs import LoadedRun
from .run_groups import Group, Summary, differing_fields, final_value, t_interval
from .text_tables import format_number, format_table

__all__ = ["Comparison", "differences_of", "text_report", "to_html"]


@dataclass
class Comparison:
    """Groups of runs, the metrics to compare, and the results."""

    groups: list[Group]
    """The groups, in the order of their colours."""
    metrics: list[str]
    """Columns to compare; the table is about the first."""
    summaries: list[Summary]
    """Rows of the table."""
    x: str
    """x axis of the curves: ``steps``, ``iterations`` or ``seconds``."""
    notes: list[str]
    """Notes for the reader."""

    @property
    def title(self) -> str:
        """Tasks, and numbers of runs and groups."""
        runs = sum(len(group.runs) for group in self.groups)
        tasks = dict.fromkeys(str(run.config.get("run.task", "")) for group in self.groups for run in group.runs)
        named = ", ".join(task for task in tasks if task)
        what = f"{runs} run{'s' * (runs != 1)} in {len(self.groups)} group{'s' * (len(self.groups) != 1)}"
        return f"{named}: {what}" if named else what


def differences_of(groups: Sequence[Group]) -> list[tuple[str, list[str]]]:
    """Fields that differ between groups, with their values in each; seeds within a group do not count."""
    configs = [run.config for group in groups for run in group.runs]
    settings = differing_fields(configs)
    # Behind the settings, since they explain less: the task and the commits.
    others = [name for name in differing_fields(configs, settings_only=False) if name.startswith(("run.", "git."))]
    rows = [(name, [_values(group, name) for group in groups]) for name in dict.fromkeys(settings + others)]
    return [(name, values) for name, values in rows if len(set(values)) > 1]


def _values(group: Group, name: str) -> str:
    """All values that a field has in a group."""
    values = {_plain(run.config[name]) if name in run.config else "(none)" for run in group.runs}
    return ", ".join(sorted(values))


def _plain(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _header(comparison: Comparison) -> list[str]:
    return ["group", "runs", f"final {comparison.metrics[0]}", "best", "samples to 90 %", "seconds to 90 %", "steps/s"]


def _row(row: Summary) -> list[str]:
    return [
        row.group,
        str(row.runs),
        _interval(row.final, row.final_half),
        format_number(row.best),
        _whole(row.steps_to_reach),
        format_number(row.seconds_to_reach, 3),
        _whole(row.steps_per_s),
    ]


def _whole(value: float) -> str:
    return format_number(round(value)) if math.isfinite(value) else "-"


def _interval(mean: float, half: float) -> str:
    return format_number(mean) + (f" ± {format_number(half, 2)}" if math.isfinite(half) else "")


def text_report(comparison: Comparison) -> str:
    """The tables for a terminal. Groups with long names are numbered."""
    names = [group.name for group in comparison.groups]
    # Long names would make the second table, which has a column for each group, too wide for a terminal.
    numbered = len(names) > 1 and max(map(len, names)) > 24
    head = [str(at + 1) for at in range(len(names))] if numbered else names
    body = [_row(row) for row in comparison.summaries]
    if numbered:
        body = [[f"{names.index(row[0]) + 1}: {row[0]}", *row[1:]] for row in body]
    parts = [comparison.title, format_table(_header(comparison), body)]
    rows = differences_of(comparison.groups)
    if rows:
        fields = [[name, *map(_cut, values)] for name, values in rows]
        parts.append(format_table(["differs", *head], fields))
    elif len(comparison.groups) > 1:
        parts.append("the configs do not differ")
    return "\n\n".join([*parts, *(f"note: {note}" for note in comparison.notes)])


def _cut(value: str) -> str:
    return value if len(value) <= 40 else f"{value[:37]}..."


# -- HTML


def to_html(comparison: Comparison) -> str:
    """The comparison as one HTML page, which adapts to the width of the screen and to a dark theme."""
    page = _Page(comparison)
    sections = [*page.head(), *page.table(), *page.curves(), *page.final_values(), *page.differences(), page.runs()]
    return html_document(comparison.title, sections)


class _Page:
    """Sections of the page, each as HTML."""

    def __init__(self, comparison: Comparison):
        self._comparison, self._groups, self._metrics = comparison, comparison.groups, comparison.metrics
        self._number_of = {group.name: number % len(COLORS) for number, group in enumerate(comparison.groups)}

    def _key(self, name: str) -> str:
        """The colour of a group, as a small mark."""
        return f'<span class="key" style="background: var(--group-{self._number_of[name]})"></span>'

    def _heads(self, first: str) -> list[str]:
        """Cells of a header: a name, and then the groups."""
        return [first, *(self._key(group.name) + html.escape(group.name) for group in self._groups)]

    def head(self) -> list[str]:
        """Title, explanation, notes and legend."""
        comparison = self._comparison
        legend = "".join(
            f"<li>{self._key(group.name)}{html.escape(group.name)} ({len(group.runs)})</li>" for group in self._groups
        )
        return [
            f"<h1>{html.escape(comparison.title)}</h1>",
            f"<p>{html.escape(_explained(comparison))}</p>",
            *(f'<p class="note">{html.escape(note)}</p>' for note in comparison.notes),
            f'<ul class="legend">{legend}</ul>',
        ]

    def table(self) -> list[str]:
        """The table of the groups; the best is marked."""
        body = []
        for place, row in enumerate(self._comparison.summaries):
            cells = [html.escape(cell) for cell in _row(row)]
            cells[0] = self._key(row.group) + cells[0]
            body.append((cells, place == 0 and len(self._groups) > 1))
        header = [html.escape(name) for name in _header(self._comparison)]
        return [html_table(header, body), f"<p>{html.escape(_table_explained())}</p>"]

    def curves(self) -> list[str]:
        """A chart of each metric."""
        charts = (
            f"<figure><figcaption>{html.escape(name)}</figcaption>"
            f"{chart_svg(self._groups, name, self._comparison.x)}</figure>"
            for name in self._metrics
        )
        return ["<h2>Curves</h2>", '<div class="charts">', *charts, "</div>"]

    def final_values(self) -> list[str]:
        """The table of final values, if there are several metrics."""
        if len(self._metrics) < 2:
            return []
        rows = [
            ([html.escape(name), *(html.escape(_interval(*_final(group, name))) for group in self._groups)], False)
            for name in self._metrics
        ]
        return ["<h2>All metrics at the end</h2>", html_table(self._heads("final value"), rows)]

    def differences(self) -> list[str]:
        """The table of fields that differ."""
        rows = differences_of(self._groups)
        if rows:
            fields = [([html.escape(name), *map(html.escape, values)], False) for name, values in rows]
            return ["<h2>What differs</h2>", html_table(self._heads("field"), fields, "fields")]
        return ["<h2>What differs</h2>", "<p>The configs do not differ.</p>"] if len(self._groups) > 1 else []

    def runs(self) -> str:
        """The list of runs, folded."""
        items = "".join(
            f"<li>{self._key(group.name)}{html.escape(group.name)}, "
            f"{html.escape(_seed(run))}{len(run.x['iterations'])} iterations: "
            f"<code>{html.escape(str(run.path))}</code></li>"
            for group in self._groups
            for run in group.runs
        )
        return f"<details><summary>Runs</summary><ul>{items}</ul></details>"


def _explained(comparison: Comparison) -> str:
    x = X_LABELS[comparison.x]
    if all(len(group.runs) == 1 for group in comparison.groups):
        return f"Over {x}. One run in each group, so there are no confidence bands."
    band = "95 % confidence interval of the mean (Student's t)"
    return f"Over {x}: mean over the runs, each run as a thin line; band: {band}."


def _table_explained() -> str:
    return (
        "Final: mean of the last 5 % of the iterations, ± half width of the 95 % confidence interval over the runs "
        "(Student's t, n - 1 degrees of freedom). 90 %: of the best group's final value, reached by the mean curve; "
        "steps/s: samples in a second of training."
    )


def _final(group: Group, metric: str) -> tuple[float, float]:
    values = np.array([value for run in group.runs if math.isfinite(value := final_value(run, metric))])
    if not len(values):
        return math.nan, math.nan
    mean, half = t_interval(values)
    return float(mean), float(half)


def _seed(run: LoadedRun) -> str:
    seed = run.config.get("agent.seed", run.config.get("env.seed"))
    return "" if seed is None else f"seed {seed}, "
