# SPDX-License-Identifier: Apache-2.0
"""Comparison of runs: curves, tables, statistics and errors."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from PIL import Image

from stripe_newton.cli import main
from stripe_newton.rl.experiments.comparison_report import Comparison, differences_of, text_report, to_html
from stripe_newton.rl.experiments.curve_charts import chart_svg
from stripe_newton.rl.experiments.loaded_runs import CompareError, LoadedRun, find_runs, load_run
from stripe_newton.rl.experiments.run_groups import (
    Group,
    curve_of,
    differing_fields,
    final_value,
    group_runs,
    pick_metrics,
    summarize,
    t_interval,
)
from stripe_newton.rl.experiments.text_tables import format_number, format_table, short_names
from tests.helpers.run_files import REWARD, write_run

LENGTH = "Train/mean_episode_length"


def loaded(values, steps=None, seconds=None, config=None, name: str = "r") -> LoadedRun:
    count = len(values)
    x = {
        "iterations": np.arange(1.0, count + 1.0),
        "steps": np.arange(1.0, count + 1.0) * 100.0 if steps is None else np.asarray(steps, dtype=float),
        "seconds": np.arange(1.0, count + 1.0) if seconds is None else np.asarray(seconds, dtype=float),
    }
    return LoadedRun(Path(name), x, {REWARD: np.asarray(values, dtype=float)}, config or {})


# -- statistics


@pytest.mark.parametrize("count", [2, 3, 5, 30])
def test_the_interval_is_students(count):
    values = np.random.default_rng(count).normal(3.0, 2.0, (count, 7))
    mean, half = t_interval(values)
    for column in range(7):
        expected = scipy.stats.ttest_1samp(values[:, column], 0.0).confidence_interval(0.95)
        assert mean[column] - half[column] == pytest.approx(expected.low)
        assert mean[column] + half[column] == pytest.approx(expected.high)


def test_the_interval_covers_the_mean_as_often_as_it_says():
    draws = np.random.default_rng(0).normal(1.0, 1.0, (4, 20_000))
    mean, half = t_interval(draws)
    assert np.mean(np.abs(mean - 1.0) <= half) == pytest.approx(0.95, abs=0.005)


def test_a_single_run_has_no_interval():
    mean, half = t_interval(np.array([[1.0, 2.0]]))
    assert mean.tolist() == [1.0, 2.0]
    assert np.isnan(half).all()


def test_a_curve_over_places_that_all_runs_share():
    values = np.random.default_rng(1).normal(size=(3, 20))
    curve = curve_of(Group("g", [loaded(row) for row in values]), REWARD, "steps")
    np.testing.assert_allclose(curve.x, np.arange(1, 21) * 100)
    np.testing.assert_allclose(curve.mean, values.sum(0) / 3)
    sem = np.sqrt(((values - values.sum(0) / 3) ** 2).sum(0) / 2 / 3)
    np.testing.assert_allclose(curve.half, 4.302653 * sem, rtol=1e-6)  # tabulated: t, 2 degrees of freedom, 0.975


def test_a_curve_over_other_places_is_interpolated_where_all_runs_are():
    one = loaded([0.0, 10.0, 20.0], seconds=[0.0, 10.0, 20.0])
    two = loaded([5.0, 15.0, 35.0], seconds=[4.0, 8.0, 16.0])
    curve = curve_of(Group("g", [one, two]), REWARD, "seconds")
    assert (curve.x[0], curve.x[-1]) == (4.0, 16.0)
    middle = len(curve.x) // 2
    assert curve.x[middle] == 10.0
    assert curve.mean[middle] == pytest.approx((10.0 + 20.0) / 2)  # 10 s: the second is at 15 + 2 / 8 * 20
    late = loaded([1.0, 2.0], seconds=[30.0, 40.0])
    assert curve_of(Group("g", [one, late]), REWARD, "seconds") is None


def test_a_curve_leaves_out_what_was_not_logged():
    curve = curve_of(Group("g", [loaded([np.nan, np.nan, 3.0, 4.0])]), REWARD, "iterations")
    assert curve.x.tolist() == [3.0, 4.0]
    assert curve.mean.tolist() == [3.0, 4.0]
    assert curve_of(Group("g", [loaded([np.nan])]), REWARD, "iterations") is None
    assert curve_of(Group("g", [loaded([1.0])]), "Other/one", "iterations") is None


def test_long_curves_are_averaged_over_neighbours():
    values = np.random.default_rng(2).normal(size=1001)
    curve = curve_of(Group("g", [loaded(values)]), REWARD, "iterations")
    assert len(curve.x) == 300
    assert curve_of(Group("g", [loaded(values)]), REWARD, "iterations", None).mean.tolist() == values.tolist()
    edges = [int(1001 * at / 300) for at in range(301)]
    for at in (0, 7, 299):
        part = slice(edges[at], edges[at + 1])
        assert curve.mean[at] == pytest.approx(sum(values[part]) / len(values[part]))
        assert curve.x[at] == pytest.approx(np.arange(1, 1002)[part].mean())


def test_the_final_value_is_of_the_last_twentieth():
    values = list(range(100))
    assert final_value(loaded(values), REWARD) == pytest.approx((95 + 96 + 97 + 98 + 99) / 5)
    values[97] = np.nan
    assert final_value(loaded(values), REWARD) == pytest.approx((95 + 96 + 98 + 99) / 4)
    assert final_value(loaded([1.0, 7.0]), REWARD) == 7.0
    assert math.isnan(final_value(loaded([np.nan]), REWARD))


def test_the_table():
    good = Group(
        "good",
        [loaded([0, 4, 8, 10, 10], seconds=[2, 4, 6, 8, 10]), loaded([0, 6, 10, 10, 10], seconds=[1, 2, 3, 4, 5])],
    )
    poor = Group("poor", [loaded([0, 1, 2, 9, 3], seconds=[2, 4, 6, 8, 10])])
    never = Group("never", [loaded([np.nan] * 5)])
    rows = summarize([poor, never, good], REWARD)
    assert [row.group for row in rows] == ["good", "poor", "never"]
    assert (rows[0].final, rows[0].final_half, rows[0].best, rows[0].runs) == (10.0, 0.0, 10.0, 2)
    assert (rows[0].steps_to_reach, rows[0].seconds_to_reach) == (
        300.0,
        4.5,
    )  # the mean of 8 and 10 is 9, after 6 and 3 s
    assert (rows[1].final, rows[1].best, rows[1].steps_to_reach) == (3.0, 9.0, 400.0)
    assert math.isnan(rows[1].final_half)
    assert rows[1].seconds_to_reach == 8.0
    assert (rows[0].steps_per_s, rows[1].steps_per_s) == (75.0, 50.0)
    timeless = Group("t", [loaded([0.0, 1.0, 2.0], steps=[np.nan] * 3, seconds=[5, 6, 7])])
    assert summarize([timeless], REWARD)[0].seconds_to_reach == 7.0  # known without samples
    assert math.isnan(rows[2].final)
    assert math.isnan(rows[2].steps_to_reach)


def test_the_interval_of_the_table_is_over_runs():
    finals = [3.0, 5.0, 10.0]
    row = summarize([Group("g", [loaded([value]) for value in finals])], REWARD)[0]
    low, high = scipy.stats.t.interval(0.95, 2, loc=6.0, scale=scipy.stats.sem(finals))
    assert (row.final - row.final_half, row.final + row.final_half) == pytest.approx((low, high))


def test_negative_values_and_costs():
    groups = [Group("a", [loaded([-30.0, -11.0, -10.0])]), Group("b", [loaded([-30.0, -20.0, -12.0])])]
    rows = summarize(groups, REWARD)
    assert (rows[0].group, rows[0].steps_to_reach) == ("a", 200.0)  # -11: a tenth of 10 below -10
    assert math.isnan(rows[1].steps_to_reach)
    costs = [Group("a", [loaded([9.0, 5.0, 5.0])]), Group("b", [loaded([9.0, 2.2, 2.0])])]
    rows = summarize(costs, REWARD, minimize=True)
    assert [row.group for row in rows] == ["b", "a"]
    assert (rows[0].best, rows[0].steps_to_reach) == (2.0, 200.0)


# -- reading


def test_reading_a_run():
    run = load_run(write_run("one", [1.0, None, 3.0], seed=4, **{"Metrics/x": [5.0, 6.0, 7.0]}))
    assert run.x["iterations"].tolist() == [1.0, 2.0, 3.0]
    assert run.x["steps"].tolist() == [100.0, 200.0, 300.0]
    assert run.x["seconds"].tolist() == [2.0, 4.0, 6.0]
    np.testing.assert_array_equal(run.columns[REWARD], [1.0, np.nan, 3.0])
    assert run.columns["Metrics/x"].tolist() == [5.0, 6.0, 7.0]
    assert (run.config["env.scene.num_envs"], run.config["agent.seed"], run.config["run.task"]) == (10, 4, "Fake-v0")
    assert run.label == "fake"


def test_runs_below_a_folder_are_found():
    for name in ("a/one", "a/b/two", "three"):
        write_run(Path("logs") / name, [1.0])
    assert find_runs("logs") == [Path("logs/a/b/two"), Path("logs/a/one"), Path("logs/three")]
    assert find_runs("logs/three") == [Path("logs/three")]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_events_of_isaac_lab_are_read():
    from torch.utils.tensorboard import SummaryWriter

    values = [1.0, 2.5, 4.0]
    with SummaryWriter("isaac/2026-01-01") as writer:
        for step, value in enumerate(values):
            writer.add_scalar(REWARD, value, step, walltime=1000.0 + 3.0 * step)
            writer.add_scalar(f"{REWARD}/time", value, 77 + step)
            if step:
                writer.add_scalar("Metrics/base_velocity/error", -value, step, walltime=1000.5 + 3.0 * step)
    with SummaryWriter("isaac/2026-01-01") as writer:  # resumed from iteration 2
        writer.add_scalar(REWARD, 8.0, 2, walltime=1020.0)
    params = Path("isaac/2026-01-01/params")
    params.mkdir()
    (params / "env.yaml").write_text(
        "seed: 42\nscene:\n  num_envs: 64\nfunc: !!python/name:isaaclab.envs.mdp.foo ''\n"
        "pos: !!python/tuple\n- 0.0\n- 1.0\nids: !!python/object/apply:builtins.slice\n- null\n- null\n"
    )
    (params / "agent.yaml").write_text("seed: 42\nnum_steps_per_env: 24\n")
    run = load_run(find_runs("isaac")[0])
    assert list(run.columns) == [REWARD, "Metrics/base_velocity/error"]
    assert run.columns[REWARD].tolist() == [1.0, 2.5, 8.0]
    np.testing.assert_array_equal(run.columns["Metrics/base_velocity/error"], [np.nan, -2.5, -4.0])
    assert run.x["iterations"].tolist() == [1.0, 2.0, 3.0]
    assert run.x["steps"].tolist() == [64 * 24.0, 2 * 64 * 24.0, 3 * 64 * 24.0]
    assert run.x["seconds"].tolist()[:2] == [0.0, 3.0]
    assert run.config["env.pos"] == [0.0, 1.0]
    assert run.config["env.func"] == "name:isaaclab.envs.mdp.foo"


def test_what_cannot_be_read():
    with pytest.raises(CompareError, match="none: is not a folder"):
        find_runs("none")
    Path("empty").mkdir()
    with pytest.raises(CompareError, match="empty: contains no run"):
        find_runs("empty")
    with pytest.raises(CompareError, match="no iteration was logged"):
        load_run(write_run("started", []))
    (write_run("broken", [1.0]) / "metrics.csv").write_text("iteration,total_steps\n0,x\n")
    with pytest.raises(CompareError, match="broken: cannot be read"):
        load_run(Path("broken"))
    (write_run("foreign", [1.0]) / "metrics.csv").write_text("a,b\n0,1\n")
    with pytest.raises(CompareError, match=r"metrics\.csv has no column iteration"):
        load_run(Path("foreign"))


# -- groups, metrics, differences


def runs_of(**gammas: tuple[float, ...]) -> list[LoadedRun]:
    """Runs ``NAME_SEED`` with ``algorithm.gamma``."""
    return [
        load_run(write_run(f"{name}_{seed}", [gamma], seed, agent={"algorithm": {"gamma": gamma}}))
        for name, values in gammas.items()
        for seed, gamma in enumerate(values)
    ]


def test_runs_that_differ_by_seed_are_one_group():
    groups = group_runs(runs_of(low=(0.9, 0.9), high=(0.99, 0.99, 0.99)))
    assert [(group.name, len(group.runs)) for group in groups] == [("gamma 0.9", 2), ("gamma 0.99", 3)]


def test_names_devices_and_seeds_do_not_make_groups():
    here = {"sim": {"device": "cuda:0"}, "scene": {"num_envs": 10}}
    there = {"sim": {"device": "cuda:3"}, "scene": {"num_envs": 10}}
    paths = [write_run("a", [1.0], 1, env=here), write_run("b", [1.0], 2, env=there, agent={"run_name": "x"})]
    assert [group.name for group in group_runs([load_run(path) for path in paths])] == ["fake"]
    cpu = load_run(write_run("c", [1.0], 1, env={"sim": {"device": "cpu"}, "scene": {"num_envs": 10}}))
    assert len(group_runs([*map(load_run, paths), cpu])) == 2


def test_groups_by_fields():
    runs = [
        load_run(write_run(f"{gamma}_{lam}", [1.0], agent={"algorithm": {"gamma": gamma, "lam": lam}}))
        for gamma in (0.99, 0.9)
        for lam in (0.5, 0.7)
    ]
    assert [group.name for group in group_runs(runs)] == [
        "gamma 0.9, lam 0.5",
        "gamma 0.9, lam 0.7",
        "gamma 0.99, lam 0.5",
        "gamma 0.99, lam 0.7",
    ]
    for name in ("agent.algorithm.gamma", "--agent.algorithm.gamma", "gamma"):
        assert [(group.name, len(group.runs)) for group in group_runs(runs, [name])] == [
            ("gamma 0.9", 2),
            ("gamma 0.99", 2),
        ]
    with pytest.raises(CompareError, match=r"--group-by gama: no run has this field"):
        group_runs(runs, ["gama"])
    with pytest.raises(CompareError, match=r"--group-by seed: .* it may be env\.seed, agent\.seed"):
        group_runs(runs, ["seed"])


def test_metrics_that_all_runs_have():
    one = load_run(
        write_run("a", [1.0], **{"Episode_Reward/up": [1.0], "Loss/value": [1.0], LENGTH: [1.0], "Metrics/m": [2.0]})
    )
    two = load_run(write_run("b", [1.0], **{"Episode_Reward/up": [1.0], "Loss/value": [1.0], LENGTH: [1.0]}))
    groups = [Group("a", [one]), Group("b", [two])]
    assert pick_metrics(groups) == [REWARD, LENGTH, "Episode_Reward/up"]
    assert pick_metrics(groups, ["Loss/*", "Metrics/m"]) == ["Loss/value", "Metrics/m"]
    with pytest.raises(CompareError, match=r"--metric Loss/valu: no run has it; there are Train/mean_reward"):
        pick_metrics(groups, ["Loss/valu"])


def test_only_fields_that_differ_between_groups_are_told():
    runs = runs_of(low=(0.9, 0.9), high=(0.99,))
    for number, run in enumerate(runs):
        run.config["git.main.commit"] = f"c{number}"
        run.config["run.version"] = "0.1"
    groups = group_runs(runs)
    assert differences_of(groups) == [
        ("agent.algorithm.gamma", ["0.9", "0.99"]),
        ("git.main.commit", ["c0, c1", "c2"]),
    ]
    assert differing_fields(run.config for run in runs) == ["agent.algorithm.gamma"]


def test_commits_are_read_from_what_rsl_rl_writes():
    path = write_run("a", [1.0])
    (path / "git").mkdir()
    text = "--- git commit ---\n0123456789abcdef\n\n\n--- git status ---\nclean\n\n\n--- git diff ---\n"
    (path / "git" / "main.diff").write_text(text)
    (path / "git" / "own.diff").write_text(text + "+a line\n")
    config = load_run(path).config
    assert (config["git.main.commit"], config["git.main.uncommitted_changes"]) == ("0123456789", "none")
    assert re.fullmatch("[0-9a-f]{8}", config["git.own.uncommitted_changes"])


# -- what is shown


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


# -- tables


def test_numbers_and_tables():
    numbers = [0.000123456, 3.0, 12345.678, 123456, float("nan"), None, "x", True, 1e-4]
    shown = ["0.0001235", "3", "12,346", "123,456", "-", "-", "x", "True", "0.0001"]
    assert [format_number(number) for number in numbers] == shown
    assert format_table(["a", "number"], [["x", 1.5], ["long", None]]).splitlines() == [
        "a     number",
        "----  ------",
        "x        1.5",
        "long       -",
    ]


def test_short_names_are_told_apart():
    names = short_names(["agent.actor.lr", "agent.critic.lr", "agent.gamma", "gamma"])
    assert names["agent.actor.lr"] == "actor.lr"
    assert names["agent.critic.lr"] == "critic.lr"
    assert names["agent.gamma"] == "agent.gamma"
    assert names["gamma"] == "gamma"
