# SPDX-License-Identifier: Apache-2.0
"""Comparison of runs: the page, its charts, the text report and the command."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stripe_newton.cli import main
from stripe_newton.rl.experiments.comparison_report import Comparison, text_report, to_html
from stripe_newton.rl.experiments.curve_charts import chart_svg
from stripe_newton.rl.experiments.loaded_runs import LoadedRun, load_run
from stripe_newton.rl.experiments.run_groups import (
    Group,
    group_runs,
    pick_metrics,
    summarize,
)
from stripe_newton.rl.experiments.text_tables import format_number
from tests.helpers.loaded_runs import loaded
from tests.helpers.run_files import REWARD, write_run

LENGTH = "Train/mean_episode_length"


class Balanced(HTMLParser):
    """Fails on tags that are not closed in order; keeps tags and text."""

    VOID = ("meta", "br", "use", "path", "circle", "rect")

    def __init__(self, page: str):
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.text = ""
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.attributes += attrs
        if tag not in ("meta",):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.seen.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture
def comparison() -> Comparison:
    rng = np.random.default_rng(0)
    runs = [
        load_run(
            write_run(
                f"{name}_{seed}",
                np.linspace(0, top, 40) + rng.normal(0, 0.5, 40),
                seed,
                agent={"algorithm": {"gamma": top, "kind": f"<{name}>"}},
                **{LENGTH: rng.normal(100, 3, 40)},
            )
        )
        for name, top in (("low", 4.0), ("high", 9.0))
        for seed in range(3)
    ]
    groups = group_runs(runs, ["gamma", "kind"])
    metrics = pick_metrics(groups)
    return Comparison(groups, metrics, summarize(groups, metrics[0]), "steps", ["a <note>"])


def test_the_page_is_one_whole_file(comparison):
    page = to_html(comparison)
    parsed = Balanced(page)
    assert not {"script", "link", "img", "iframe"} & set(parsed.seen)
    for name, value in parsed.attributes:
        assert not (name in ("src", "href") and value and not value.startswith("#")), (name, value)
        assert name.startswith("xmlns") or "http" not in (value or "")
    assert parsed.seen.count("svg") == 2
    assert "prefers-color-scheme: dark" in page
    assert "width=device-width" in page
    for text in (
        "Fake-v0: 6 runs in 2 groups",
        "gamma 9, kind <high>",
        "a <note>",
        "95 % confidence interval",
        REWARD,
        LENGTH,
    ):
        assert text in parsed.text
    final = format_number(comparison.summaries[0].final)
    assert f"{final} ± {format_number(comparison.summaries[0].final_half, 2)}" in parsed.text


def test_charts_take_their_colours_from_the_page(comparison):
    svg = chart_svg(comparison.groups, REWARD, "steps")
    root = ET.fromstring(svg)
    assert root.get("viewBox")
    assert root.get("width") is None
    for name in ("var(--group-0)", "var(--group-1)", "var(--text)", "var(--grid)"):
        assert name in svg
    assert not re.findall(r"#(?:0a0b|0102|0405)\w\w", svg)
    labels = [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
    assert "samples" in labels
    assert "4k" in labels


def test_the_text_report(comparison):
    lines = text_report(comparison).splitlines()
    assert lines[0] == "Fake-v0: 6 runs in 2 groups"
    assert re.split(r"\s{2,}", lines[2])[:4] == ["group", "runs", f"final {REWARD}", "best"]
    assert lines[4].startswith("gamma 9, kind <high>")
    assert ["agent.algorithm.gamma", "4", "9"] in [line.split() for line in lines]
    assert lines[-1] == "note: a <note>"


def test_names_have_as_few_fields_as_tell_the_groups_apart():
    def run(number: int, rate: float, damping: float, length: int) -> LoadedRun:
        env = {
            "rewards": {"alive": {"weight": damping}},
            "scene": {"robot": {"actuators": {"cart": {"damping": damping}}}},
        }
        agent = {"algorithm": {"learning_rate": rate}, "max_iterations": length}
        return load_run(write_run(f"run_{number}", [1.0], env=env, agent=agent))

    runs = [run(0, 0.001, 5.0, 1), run(1, 0.001, 10.0, 2), run(2, 0.003, 10.0, 2), run(3, 0.01, 10.0, 9)]
    assert sorted(group.name for group in group_runs(runs)) == [
        "cart.damping 10, learning_rate 0.001",
        "cart.damping 10, learning_rate 0.003",
        "cart.damping 10, learning_rate 0.01",
        "cart.damping 5, learning_rate 0.001",
    ]


def test_a_run_of_one_iteration_is_a_point():
    svg = chart_svg([Group("one", [loaded([3.0])]), Group("two", [loaded([1.0, 2.0])])], REWARD, "iterations")
    assert "<use" in svg  # a marker


def test_long_names_are_numbered_in_a_terminal():
    groups = [Group(f"a group whose name is long, number {number}", [loaded([1.0])]) for number in (7, 8)]
    groups[0].runs[0].config["agent.gamma"] = 0.5
    lines = text_report(Comparison(groups, [REWARD], summarize(groups, REWARD), "steps", [])).splitlines()
    assert lines[4].startswith("1: a group whose name is long, number 7")
    assert lines[7].split() == ["differs", "1", "2"]
    assert lines[9].split() == ["agent.gamma", "0.5", "(none)"]


def test_the_command(capsys):
    for gamma in (0.9, 0.99):
        for seed in (1, 2):
            write_run(f"logs/g{gamma}/{seed}", [gamma * at for at in range(20)], seed, agent={"gamma": gamma})
    write_run("logs/begun", [])
    assert main(["compare", "logs", "--out", "here/cmp", "--x", "seconds"]) == 0
    out = capsys.readouterr().out
    assert "Fake-v0: 4 runs in 2 groups" in out
    assert "note: left out: logs/begun: no iteration was logged" in out
    assert [line.split()[0] for line in out.splitlines()[4:6]] == ["gamma", "gamma"]
    assert out.splitlines()[4].startswith("gamma 0.99")
    with Image.open("here/cmp/compare.png") as image:
        assert image.width > 400
        assert len(image.convert("RGB").getcolors(1 << 20)) > 50
    assert "Over seconds" in Path("here/cmp/compare.html").read_text(encoding="utf-8")

    assert (
        main(["compare", "mine=logs/g0.9/1,logs/g0.9/2", "logs/g0.99", "--metric", "Train/*", "--minimize", "True"])
        == 0
    )
    out = capsys.readouterr().out
    assert out.splitlines()[4].startswith("mine ")
    assert Path("compare/compare.html").exists()


def test_runs_of_unequal_length_are_told(capsys):
    write_run("a", [1.0] * 20, 1)
    write_run("b", [1.0] * 10, 2)
    assert main(["compare", "a", "b"]) == 0
    assert "its runs have 10 to 20 iterations" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ([], "compare needs runs"),
        (["none"], "none: is not a folder"),
        (["a", "--metric", "Loss/x"], "--metric Loss/x: no run has it"),
        (["a", "--group-by", "gamma"], "--group-by gamma: no run has this field"),
        (["mine="], "a group is NAME=PATH"),
        (["x=a", "x=a"], "two groups are called 'x'"),
        (["begun"], "begun: no iteration was logged"),
        (["a", "--out", "a/metrics.csv"], "--out a/metrics.csv: "),
    ],
)
def test_errors_are_one_message(capsys, words, part):
    write_run("a", [1.0])
    write_run("begun", [])
    assert main(["compare", *words]) == 2
    error = capsys.readouterr().err
    assert part in error
    assert "Traceback" not in error


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_runs_that_do_not_tell_their_samples(capsys):
    from torch.utils.tensorboard import SummaryWriter

    with SummaryWriter("bare") as writer:
        writer.add_scalar(REWARD, 1.0, 0)
        writer.add_scalar(REWARD, 2.0, 1)
    assert main(["compare", "bare"]) == 2
    assert "does not say how many samples it took; give --x iterations" in capsys.readouterr().err
    assert main(["compare", "bare", "--x", "iterations"]) == 0
