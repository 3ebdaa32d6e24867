# SPDX-License-Identifier: Apache-2.0
"""Report of runs: its numbers are those of the files, nothing is loaded, and names of any kind do no harm."""

from __future__ import annotations

import json
import math
import os
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.ticker import MaxNLocator

from stripe_newton.cli import main
from stripe_newton.rl import read_metrics
from stripe_newton.rl.report import report_page
from stripe_newton.rl.report.line_chart import Line, chart_svg, nice_ticks, thin, tick_text
from stripe_newton.rl.report.report_data import read_run
from stripe_newton.rl.report.report_page import report_html
from stripe_newton.rl.report.run_facts import read_facts, write_changes, write_system
from stripe_newton.rl.report.run_report import RunReport, write_report
from stripe_newton.rl.runs.run_folder import RunFolder
from tests.helpers.run_files import REWARD, write_run

VOID = {"meta", "link", "br", "wbr", "img", "input", "hr"}
NASTY = '"><script>alert(1)</script><img src=x onerror=alert(2)>'


class Page(HTMLParser):
    """Tags, attributes, scripts and text of a page; a tag that is not closed in its turn is an error."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)
        elif self.open and self.open[-1] != "style":
            self.text += data

    def curves(self) -> dict[str, list[dict]]:
        """The curves of each column, one for each run."""
        charts = [attrs for tag, attrs in self.tags if tag == "figure" and "data-chart" in attrs]
        data = json.loads(self.scripts[0])
        return {attrs["data-column"]: data[int(attrs["data-chart"])] for attrs in charts}


def page_of(*folders: Path, **options) -> Page:
    runs = [read_run(folder) for folder in folders]
    return Page(report_html(runs, options.pop("x", "iterations"), folders[0], **options))


def write_full_run(path: Path, count: int = 40) -> Path:
    numbers = np.random.default_rng(3)
    columns = {
        "Episode_Reward/track": numbers.normal(size=count),
        "Episode_Termination/fall": [math.nan, *numbers.random(count - 1)],
        "Loss/value": numbers.random(count) * 1e6,
        "Perf/collection_time": np.full(count, 1.5),
        "Perf/learning_time": np.full(count, 0.5),
    }
    return write_run(path, numbers.normal(size=count), agent={"max_iterations": 50}, **columns)


def test_its_numbers_are_those_of_the_metrics_file(tmp_path):
    run = write_full_run(tmp_path / "run")
    page, metrics = page_of(run), read_metrics(run / "metrics.csv")
    curves = page.curves()
    assert curves.keys() == metrics.keys() - {"iteration", "total_steps", "elapsed_s"}
    for column, (line,) in curves.items():
        assert line["x"] == [iteration + 1.0 for iteration in metrics["iteration"]]
        there = [math.nan if value is None else value for value in line["y"]]
        np.testing.assert_allclose(there, metrics[column], rtol=1e-6)
    assert "40 of 50 iterations" in page.text
    assert "1500 ms (75 %)" in page.text
    assert "500 ms (25 %)" in page.text


def test_charts_stand_under_their_headings(tmp_path):
    run = write_full_run(tmp_path / "run")
    text = report_html([read_run(run)], "steps", run)
    under: dict[str, list[str]] = {}
    columns: list[str] = []
    for heading, column in re.findall(r'<h2>([^<]*)</h2>|data-column="([^"]*)"', text):
        if heading:
            columns = under.setdefault(heading, [])
        else:
            columns.append(column)
    assert under["Reward terms"] == ["Episode_Reward/track"]
    assert under["Terminations"] == ["Episode_Termination/fall"]
    assert under["Losses and exploration"] == ["Loss/value"]
    assert under["Returns and episodes"] == [REWARD]


def test_nothing_is_loaded_from_elsewhere(tmp_path):
    run = write_full_run(tmp_path / "run")
    (run / "videos").mkdir()
    (run / "videos" / "final_40.mp4").write_bytes(b"film")
    page = page_of(run)
    links = [attrs[name] for _, attrs in page.tags for name in ("src", "href") if attrs.get(name)]
    assert links == ["data:video/mp4;base64,ZmlsbQ=="]
    assert not any(tag == "link" for tag, _ in page.tags)
    assert "url(" not in report_html([read_run(run)], "steps", run)


def test_a_large_film_is_linked_relative_to_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(report_page, "MOST_FILM_BYTES", 3)
    run = write_full_run(tmp_path / 'a "run" & more')
    (run / "videos").mkdir()
    for number, name in enumerate(("iteration_9.mp4", "final 40%.mp4")):
        (run / "videos" / name).write_bytes(b"film")
        os.utime(run / "videos" / name, (number, number))
    (source,) = [attrs["src"] for tag, attrs in page_of(run).tags if tag == "video"]
    assert source == "videos/final%2040%25.mp4"
    page = Page(report_html([read_run(run)], "steps", tmp_path / "elsewhere"))
    (source,) = [attrs["src"] for tag, attrs in page.tags if tag == "video"]
    assert source == "../a%20%22run%22%20%26%20more/videos/final%2040%25.mp4"


def test_names_of_any_kind_do_no_harm(tmp_path):
    slashless = NASTY.replace("/", "")
    run = write_run(tmp_path / slashless, [1.0, 2.0], **{f"Episode_Reward/{NASTY}": [1.0, 2.0], NASTY: [3.0, 4.0]})
    folder = RunFolder(run)
    folder.write_task(NASTY)
    write_changes(folder, {f"env.{NASTY}": (NASTY, NASTY + "x")})
    page = page_of(run, run)
    assert {f"Episode_Reward/{NASTY}", NASTY} <= page.curves().keys()
    assert len(page.scripts) == 2  # its own: the numbers, and what shows them
    assert not any(tag == "img" or "onerror" in attrs for tag, attrs in page.tags)
    assert page.text.count(f"env.{NASTY}") == 1
    assert NASTY + "x" in page.text
    page = page_of(run)
    assert slashless in page.text


def test_several_runs_stand_beside_each_other(tmp_path):
    one = write_run(tmp_path / "one", [1.0, 2.0, 3.0], agent={"gamma": 0.9}, extra=[5.0, 6.0, 7.0])
    two = write_run(tmp_path / "two", [4.0, 5.0], agent={"gamma": 0.99})
    page = page_of(one, two, x="steps")
    lines = page.curves()[REWARD]
    assert [line["y"] for line in lines] == [[1.0, 2.0, 3.0], [4.0, 5.0]]
    assert lines[0]["x"] == [100.0, 200.0, 300.0]
    assert len(page.curves()["extra"]) == 1
    assert "agent.gamma" in page.text
    assert "agent.experiment_name" not in page.text


def test_a_report_is_written_while_a_run_trains(tmp_path, monkeypatch):
    run = write_full_run(tmp_path / "run")
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    report, file = RunReport(RunFolder(run)), run / "report.html"
    report.update()
    first = Page(file.read_text())
    assert ("meta", {"http-equiv": "refresh", "content": "30"}) in first.tags
    assert "training: 40 of 50" in first.text
    report._next = 101.0
    file.unlink()
    report.update()  # too early
    assert not file.exists()
    clock[0] = 102.0
    report.update()
    assert file.exists()
    report.finish()
    assert not any("http-equiv" in attrs for _, attrs in Page(file.read_text()).tags)
    assert [path.name for path in run.iterdir() if path.name.endswith(".part")] == []


def test_a_report_that_cannot_be_written_is_one_warning(tmp_path, capsys):
    RunReport(RunFolder(tmp_path / "gone")).update()  # which checkpoints warn of
    assert capsys.readouterr().err == ""
    run = write_full_run(tmp_path / "run")
    (run / "report.html").mkdir()
    report = RunReport(RunFolder(run))
    report.update()
    report.finish()
    assert capsys.readouterr().err.count("warning: report.html: could not be written") == 1


def test_facts_are_read_as_they_were_written(tmp_path):
    folder = RunFolder(write_full_run(tmp_path / "run"))
    assert read_facts(folder).changes is None
    write_system(folder, "cpu")
    write_changes(folder, {"agent.seed": (42, 7), "env.sim.device": ("auto", "cpu"), "env.a": (None, [1.5, 2])})
    facts = read_facts(folder)
    assert facts.changes == {"agent.seed": ("42", "7"), "env.a": ("None", "[1.5, 2]")}
    assert facts.system["device"].startswith("cpu")
    assert {"newton", "torch", "python", "started"} <= facts.system.keys()
    page = page_of(folder.path)
    assert facts.system["newton"] in page.text
    (folder.params / "changes.yaml").write_text("- 1")
    (folder.params / "system.yaml").write_text("a: [")
    facts = read_facts(folder)
    assert (facts.changes, facts.system) == (None, {})


def test_the_command_writes_reports(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a/run", "b/run"):
        write_full_run(tmp_path / "logs" / name)
    assert main(["report", "logs/a"]) == 0
    assert capsys.readouterr().out.strip() == "logs/a/run/report.html"
    assert main(["report", "logs", "logs/a/run", "--x", "seconds"]) == 0
    page = Page(Path("report.html").read_text())
    assert len(page.curves()[REWARD]) == 2
    assert "a/run" in page.text
    assert main(["report", "none"]) == 2
    assert "none" in capsys.readouterr().err
    assert main(["report", "logs", "--out", "logs"]) == 2
    assert "--out logs" in capsys.readouterr().err


# -- charts


@pytest.mark.parametrize("most", [3, 5, 8])
def test_ticks_are_round_and_as_many_as_matplotlib_takes(most):
    random = np.random.default_rng(most)
    for _ in range(300):
        low, span = random.normal() * 10 ** random.uniform(-3, 6), 10 ** random.uniform(-4, 7)
        ticks = nice_ticks(low, low + span, most)
        theirs = MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, low + span)
        theirs = [tick for tick in theirs if low - 1e-9 * span <= tick <= low + span * (1 + 1e-9)]
        assert 1 <= len(ticks) <= most
        assert abs(len(ticks) - len(theirs)) <= max(3, len(theirs))
        if len(ticks) > 1:
            digit = float(f"{ticks[1] - ticks[0]:.3e}".partition("e")[0])
            assert min(abs(digit - nice) for nice in (1, 2, 5, 10)) < 0.01
        assert all(low - 1e-6 * span <= tick <= low + span * (1 + 1e-6) for tick in ticks)


def test_no_ticks_without_a_range():
    assert nice_ticks(1.0, 1.0, 5) == []
    assert nice_ticks(0.0, math.inf, 5) == []


def test_texts_of_ticks():
    assert [tick_text(value) for value in (0.0, 1500.0, -2e6, 3e9, 0.25)] == ["0", "1.5k", "-2M", "3G", "0.25"]


def test_long_curves_are_means_over_neighbours():
    x, y = np.arange(1200.0), np.random.default_rng(0).normal(size=1200)
    y[4:8] = np.nan
    y[8] = np.inf
    places, values = thin(x, y, 300)
    np.testing.assert_allclose(places, x.reshape(300, 4).mean(axis=1))
    assert math.isnan(values[1])
    np.testing.assert_allclose(values[2], y[9:12].mean())
    np.testing.assert_allclose(values[3:], y[12:].reshape(297, 4).mean(axis=1))


@pytest.mark.parametrize("value", [0.0, 5.0, -3.0, 1e-30, 1e30])
def test_a_constant_curve_is_in_the_middle(value):
    svg = chart_svg([Line(np.arange(3.0), np.full(3, value))], "x")
    heights = {point.partition(",")[2] for point in re.search(r'points="([^"]*)"', svg)[1].split()}
    assert heights == {"78.0"}


def test_gaps_interrupt_a_curve():
    svg = chart_svg([Line(np.arange(6.0), np.array([1.0, 2.0, math.nan, 3.0, math.nan, math.nan]))], "x")
    assert (svg.count("<polyline"), svg.count("<circle")) == (1, 1)
    assert "no values" in chart_svg([Line(np.arange(2.0), np.full(2, math.nan))], "x")


def test_a_report_is_quick(tmp_path):
    run = write_full_run(tmp_path / "run", 3000)
    write_report([read_run(run)], run / "report.html")
    assert (run / "report.html").stat().st_size < 300_000
