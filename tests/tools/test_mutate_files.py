# SPDX-License-Identifier: Apache-2.0
"""Tool ``mutate_files.py``: damaged files load, or are refused by one error; the tool sees what does neither."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.helpers.checkout import PYTHONPATH
from tools.checks import mutate_files as tool  # puts its folder on the path

import file_worker  # isort: skip


@pytest.fixture(autouse=True)
def path_of_workers(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)


def test_the_same_seed_gives_the_same_files(tmp_path):
    first, second, third = (
        tool.damaged_files(tmp_path / name, 12, seed) for name, seed in (("a", 3), ("b", 3), ("c", 4))
    )
    contents = [[Path(case.file).read_bytes() for case in cases] for cases in (first, second, third)]
    assert contents[0] == contents[1]
    assert contents[0] != contents[2]


def test_crashes_hangs_and_tracebacks_are_seen(tmp_path, monkeypatch):
    """A worker that answers one file, dies at another, and never answers a third."""
    worker = tmp_path / "worker.py"
    worker.write_text(
        "import json, os, sys, time\n"
        "for line in sys.stdin:\n"
        "    if 'crash' in line: os.abort()\n"
        "    if 'hang' in line: time.sleep(600)\n"
        "    print(json.dumps(['loads', '', {}]), flush=True)\n"
    )
    monkeypatch.setattr(tool, "__file__", str(worker))
    monkeypatch.setattr(file_worker, "START_S", 1.0)
    cases = [tool.Case(name, "", "") for name in ("good", "crash", "good", "hang", "good")]
    tool.run_cases(cases, workers=1, timeout=2.0)
    assert [case.outcome for case in cases] == ["loads", "crash", "loads", "hang", "loads"]
    assert cases[1].text == "SIGABRT"


@pytest.mark.slow
def test_no_damaged_stage_is_a_traceback_a_crash_or_a_hang(tmp_path):
    cases = tool.damaged_files(tmp_path, 100, seed=16)
    tool.run_cases(cases, workers=2, timeout=120.0)
    outcomes = Counter(case.outcome for case in cases)
    bad = [
        f"{case.outcome}: {case.file} ({case.damage}): {case.text[-500:]}" for case in cases if case.outcome in tool.BAD
    ]
    assert not bad, "\n".join(bad)
    # Neither does all of it load, nor is all of it refused: the damage is seen, and not all of it matters.
    assert outcomes["loads"] > 10
    assert outcomes["refused"] > 10
